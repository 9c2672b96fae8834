"""What ``vat_mart`` learns from: an episode's first contact as a plan, and how many episodes that plan would open."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.demonstrations import Contact, Demonstrations

ENOUGH = 0.9
"""Share of what another demonstration moved a joint by that counts as enough: a static expert turns by 0.9 of the range
where 0.85 open, and a key frame ends a little short of its goal."""
STILL = 0.05
"""A joint that stays within this share of its largest excursion in the data has not been moved."""


@dataclass(frozen=True)
class PlanLabels:
    """Plans of a dataset, and the rows at which they are to be made.

    Attributes:
        plan_of: (I,) int64 plan of the row with this `index`; -1 for a row at which no plan is to be made.
        grasps: (P, 10) float32 pose of contact, its gripper the opening to approach with.
        waypoints: (P, K, 10) float32 poses in contact, the last repeated where there are fewer.
        share: (P,) float32 share of the same task's episodes that the plan would open.
    """

    plan_of: NDArray[np.int64]
    grasps: NDArray[np.float32]
    waypoints: NDArray[np.float32]
    share: NDArray[np.float32]


def label_plans(demonstrations: Demonstrations, waypoints: int) -> PlanLabels:
    """Makes a plan of each episode's first contact.

    It is to be made at the rows before the fingers close, from which the part can be seen: the hand is open and away.
    Whether it opens is decided by what its motions did to the object's joints, compared with what each episode of the
    same task needed: an unseen draw of what is hidden.

    Args:
        demonstrations: of any expert.
        waypoints: key frames in contact at most, K.

    Raises:
        ConfigurationError: no demonstration opens within one contact of so many key frames.
    """
    plan_of = np.full(1 + int(demonstrations.index.max()), -1, dtype=np.int64)
    plans = list(_first_contacts(demonstrations))
    for number, (rows, contact) in enumerate(plans):
        plan_of[demonstrations.index[_seen_rows(demonstrations, rows, contact)]] = number
    contacts = [contact for _, contact in plans]
    moved = np.array([_moved(demonstrations, contact, waypoints) for contact in contacts])
    tasks = demonstrations.task[[contact.start for contact in contacts]]
    share = opened_share(moved.reshape(-1, demonstrations.joints.shape[1]), tasks, *_needed(demonstrations))
    if not (share > 0).any():
        raise ConfigurationError(
            "No demonstration opens its object within one contact.",
            got=f"{len(plans)} first contacts of at most {waypoints} key frames",
            allowed="some that open it, as --expert static has for what is not locked",
            hint="--policy.waypoints=16, or demonstrations of a static expert",
        )
    grasps = np.stack([contact.grasp for contact in contacts])
    poses = np.stack([_waypoints(demonstrations, contact, waypoints) for contact in contacts])
    return PlanLabels(plan_of, grasps, poses, share)


def opened_share(
    moved: NDArray[np.float32], tasks: NDArray[np.int64], needed: NDArray[np.float32], needed_tasks: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Returns the share (P,) of the same task's episodes whose needs each plan's motion covers.

    A need is covered if every joint that the episode had to move is moved the same way, and at least `ENOUGH` as far.

    Args:
        moved: (P, J) farthest that each plan moved each joint, signed [rad or m].
        tasks: (P,) task of each plan.
        needed: (E, J) farthest position of each joint up to an episode's success.
        needed_tasks: (E,) task of each of those episodes.
    """
    share = np.zeros(len(moved), np.float32)
    for task in np.unique(tasks):
        wanted = needed[needed_tasks == task]
        if not len(wanted):
            continue
        still = np.abs(wanted) <= STILL * np.abs(wanted).max(axis=0)
        for plan in np.flatnonzero(tasks == task):
            covered = moved[plan] * np.sign(wanted) >= ENOUGH * np.abs(wanted)
            share[plan] = (covered | still).all(axis=1).mean()
    return share


def _first_contacts(demonstrations: Demonstrations) -> Iterator[tuple[slice, Contact]]:
    for rows in demonstrations.episodes():
        contacts = demonstrations.contacts(rows)
        if contacts:
            yield rows, contacts[0]


def _seen_rows(demonstrations: Demonstrations, rows: slice, contact: Contact) -> NDArray[np.int64]:
    """Rows up to the one in which the fingers close, with the hand open and away."""
    candidates = np.arange(rows.start, contact.start + 1)
    seen: NDArray[np.int64] = candidates[demonstrations.open_and_away(candidates, contact.grasp[:3])]
    return seen


def _waypoints(demonstrations: Demonstrations, contact: Contact, count: int) -> NDArray[np.float32]:
    """(count, 10): what was sent in contact; a contact without any motion stays at its grasp."""
    sent = demonstrations.commands[contact.first : min(contact.end, contact.first + count)]
    if not len(sent):
        sent = contact.grasp[None]
    found: NDArray[np.float32] = np.concatenate([sent, np.repeat(sent[-1:], count - len(sent), axis=0)])
    return found.reshape(count, ACTION_DIM)


def _moved(demonstrations: Demonstrations, contact: Contact, waypoints: int) -> NDArray[np.float32]:
    """(J,): the farthest that each joint was moved by so many key frames of a contact, up to the row behind the last.

    Counted from where the joint stood: of an episode that starts late, what another hand has done is not the plan's.
    """
    joints = demonstrations.joints[contact.start : min(contact.end, contact.first + waypoints) + 1]
    return _farthest(joints - joints[0])


def _farthest(joints: NDArray[np.float32]) -> NDArray[np.float32]:
    """(R, J) -> (J,): the number of each joint that is farthest from zero."""
    farthest: NDArray[np.float32] = joints[np.abs(joints).argmax(axis=0), np.arange(joints.shape[1])]
    return farthest


def _needed(demonstrations: Demonstrations) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """(E, J) how far each joint came until success, and the tasks (E,), of the episodes that ended in it."""
    done = [(rows, int(np.argmax(demonstrations.success[rows]))) for rows in demonstrations.episodes()]
    done = [(rows, first) for rows, first in done if demonstrations.success[rows.start + first]]
    ends = [min(rows.start + first + 1, rows.stop - 1) for rows, first in done]
    needed = [_farthest(demonstrations.joints[rows.start : end + 1]) for (rows, _), end in zip(done, ends, strict=True)]
    shape = (len(done), demonstrations.joints.shape[1])
    return np.array(needed, np.float32).reshape(shape), demonstrations.task[[rows.start for rows, _ in done]]
