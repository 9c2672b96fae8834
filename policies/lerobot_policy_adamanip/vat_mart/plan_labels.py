"""Labels of ``vat_mart``: an episode's first contact as a plan, and the share of episodes that the plan opens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.affordance.demonstrations import Contact, Demonstrations

MIN_COVERED_SHARE = 0.9
"""A plan opens the object of another demonstration if it covers this share of its joint motion. A static expert turns
0.9 of the range, 0.85 opens, and a key frame ends a little short of its goal."""
MAX_STILL_SHARE = 0.05
"""A joint has not moved if it is within this share of its largest motion in the data."""


@dataclass(frozen=True)
class PlanLabels:
    """Plans of a dataset and their rows.

    Attributes:
        plan_of: (I,) int64 plan of the row with this `index`; -1 for none.
        grasps: (P, 10) float32 pose of contact; its gripper is the opening during the approach.
        waypoints: (P, K, 10) float32 poses in contact, padded with the last.
        share: (P,) float32 share of the same task's trained episodes that the plan opens.
    """

    plan_of: NDArray[np.int64]
    grasps: NDArray[np.float32]
    waypoints: NDArray[np.float32]
    share: NDArray[np.float32]


def label_plans(demonstrations: Demonstrations, waypoints: int) -> PlanLabels:
    """Builds a plan from each episode's first contact.

    The plan's rows are those before the fingers close in which the part is visible: the hand is open and away. Its
    share compares its joint motions with those that each trained episode of the same task needed, with the hidden state
    of that episode.

    A plan has at most ``waypoints`` key frames in contact, K. Raises `ConfigurationError` if none opens an object.
    """
    plan_of = np.full(len(demonstrations), -1, dtype=np.int64)
    contacts_of = ((rows, demonstrations.contacts(rows)) for rows in demonstrations.episodes())
    plans = [(rows, contacts[0]) for rows, contacts in contacts_of if contacts]
    for number, (rows, contact) in enumerate(plans):
        candidates = np.arange(rows.start, contact.start + 1)
        visible = candidates[demonstrations.open_and_away(candidates, contact.grasp[:3])]
        plan_of[visible] = number
    contacts = [contact for _, contact in plans]
    moved = np.array([_moved(demonstrations, contact, waypoints) for contact in contacts])
    tasks = demonstrations.task[[contact.start for contact in contacts]]
    share = opened_share(moved.reshape(-1, demonstrations.joints.shape[1]), tasks, *_needed(demonstrations))
    if not (share > 0).any():
        raise ConfigurationError(
            "No demonstration opens its object within one contact.",
            got=f"{len(plans)} first contacts of at most {waypoints} key frames",
            allowed="demonstrations that open it, as those of --expert static for unlocked objects",
            hint="--policy.waypoints=16, or demonstrations of a static expert",
        )
    grasps = np.stack([contact.grasp for contact in contacts])
    poses = np.stack([_waypoints(demonstrations, contact, waypoints) for contact in contacts])
    return PlanLabels(plan_of, grasps, poses, share)


def opened_share(
    moved: NDArray[np.float32], tasks: NDArray[np.int64], needed: NDArray[np.float32], needed_tasks: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Returns the share (P,) of the same task's episodes that each plan's motion opens.

    A plan opens an episode if it moves every required joint the same way, at least `MIN_COVERED_SHARE` as far.

    Args:
        moved: (P, J) largest motion of each joint by each plan, signed [rad or m].
        tasks: (P,) task of each plan.
        needed: (E, J) farthest position of each joint until an episode's success.
        needed_tasks: (E,) task of each of those episodes.
    """
    share = np.zeros(len(moved), np.float32)
    for task in np.unique(tasks):
        required = needed[needed_tasks == task]
        if not len(required):
            continue
        still = np.abs(required) <= MAX_STILL_SHARE * np.abs(required).max(axis=0)
        for plan in np.flatnonzero(tasks == task):
            covered = moved[plan] * np.sign(required) >= MIN_COVERED_SHARE * np.abs(required)
            share[plan] = (covered | still).all(axis=1).mean()
    return share


def _waypoints(demonstrations: Demonstrations, contact: Contact, count: int) -> NDArray[np.float32]:
    """Returns the commands in contact (count, 10); a contact without motion stays at its grasp."""
    sent = demonstrations.commands[contact.first : min(contact.end, contact.first + count)]
    if not len(sent):
        sent = contact.grasp[None]
    padded: NDArray[np.float32] = np.concatenate([sent, np.repeat(sent[-1:], count - len(sent), axis=0)])
    return padded.reshape(count, ACTION_DIM)


def _moved(demonstrations: Demonstrations, contact: Contact, waypoints: int) -> NDArray[np.float32]:
    """Returns each joint's largest motion (J,) in a plan, relative to its start: late episodes start part-way."""
    joints = demonstrations.joints[contact.start : min(contact.end, contact.first + waypoints) + 1]
    return _farthest(joints - joints[0])


def _farthest(joints: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns each joint's value farthest from zero, (R, J) -> (J,)."""
    return joints[np.abs(joints).argmax(axis=0), np.arange(joints.shape[1])]  # type: ignore[no-any-return]


def _needed(demonstrations: Demonstrations) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Returns each successful trained episode's largest joint motions until success (E, J), and its task (E,)."""
    done = [(rows, int(np.argmax(demonstrations.success[rows]))) for rows in demonstrations.trained_episodes()]
    done = [(rows, first) for rows, first in done if demonstrations.success[rows.start + first]]
    ends = [min(rows.start + first + 1, rows.stop - 1) for rows, first in done]
    needed = [_farthest(demonstrations.joints[rows.start : end + 1]) for (rows, _), end in zip(done, ends, strict=True)]
    shape = (len(done), demonstrations.joints.shape[1])
    return np.array(needed, np.float32).reshape(shape), demonstrations.task[[rows.start for rows, _ in done]]
