"""Grasp labels from demonstrations: for each row, the contacts of its stretch, in which nothing moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION_DIM, POSITION_DIMS
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.affordance.demonstrations import Demonstrations
from lerobot_policy_adamanip.common.geometry import MOTION_DIM, motion_between

MAX_CONTACTS = 4
"""Largest number of contacts per row."""


@dataclass(frozen=True)
class ContactLabels:
    """Contacts of a dataset, and the rows at which they are possible.

    Attributes:
        contacts_of: (I, 4) int64 possible contacts at the row with this `index`; -1 for none.
        grasps: (P, 10) float32 pose of contact; its gripper is the opening during the approach.
        motions: (M, 7) float32 commands in contact in trained episodes, in the tool's frame.
    """

    contacts_of: NDArray[np.int64]
    grasps: NDArray[np.float32]
    motions: NDArray[np.float32]


def label_contacts(demonstrations: Demonstrations) -> ContactLabels:
    """Finds the episode's possible contacts at each row with an open hand.

    These are all contacts of the row's stretch, in which nothing moved, earlier or later. For example, if a knob and a
    handle were both grasped before anything moved, both can be grasped from the first row on. Raises
    `ConfigurationError` if there is no contact.
    """
    labels = np.full((len(demonstrations), MAX_CONTACTS), -1, dtype=np.int64)
    grasps: list[NDArray[np.float32]] = []
    for rows in demonstrations.episodes():
        numbers, stretch = np.arange(rows.start, rows.stop), demonstrations.stretches(rows)
        for contact in demonstrations.contacts(rows):
            counts = stretch == stretch[contact.start - rows.start]
            counts &= demonstrations.open_and_away(numbers, contact.grasp[:3])
            _add(labels, numbers[counts], len(grasps))
            grasps.append(contact.grasp)
    motions = motions_in_contact(demonstrations)
    if not len(motions):
        raise ConfigurationError(
            "The demonstrations contain no contact.",
            got=f"{len(demonstrations)} rows without a contact",
            allowed="episodes in which an open hand closes at a part",
            hint="adamanip collect DIR --category safe",
        )
    return ContactLabels(labels, np.stack(grasps).reshape(-1, ACTION_DIM), motions)


def _add(labels: NDArray[np.int64], rows: NDArray[np.int64], contact: int) -> None:
    """Writes a contact to the first free column of each row; a full row keeps its earlier ones."""
    for row in rows:
        free = np.flatnonzero(labels[row] < 0)
        if len(free):
            labels[row, free[0]] = contact


def motions_in_contact(demonstrations: Demonstrations) -> NDArray[np.float32]:
    """Returns the commands (M, 7) sent in contact in the episodes that are trained on, in the tool's frame."""
    spans = [contact for rows in demonstrations.trained_episodes() for contact in demonstrations.contacts(rows)]
    rows = np.concatenate([np.arange(0), *(np.arange(contact.first, contact.end) for contact in spans)])
    commands, poses = (torch.from_numpy(each[rows]) for each in (demonstrations.commands, demonstrations.poses))
    motions: NDArray[np.float32] = motion_between(commands, poses).numpy()
    return motions.reshape(-1, MOTION_DIM)


def draw_contact(grasps: Tensor, contacts: Tensor) -> tuple[Tensor, Tensor]:
    """Draws one contact per row from (B, C), padded with -1. A row without contacts gets an arbitrary one.

    Args:
        grasps: (P, 10) of all contacts.
        contacts: (B, C) as `ContactLabels.contacts_of`.

    Returns:
        grasps (B, 10), and places (B, C, 3) [m] of each row's contacts, padded with the drawn one.
    """
    preferred = torch.rand(contacts.shape, device=contacts.device) + (contacts >= 0)
    drawn = contacts.gather(1, preferred.argmax(dim=1, keepdim=True))
    known = torch.where(contacts >= 0, contacts, drawn).clamp(min=0)
    return grasps[drawn.squeeze(1).clamp(min=0)], grasps[known][..., POSITION_DIMS]
