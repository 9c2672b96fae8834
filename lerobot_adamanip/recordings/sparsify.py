"""Finds key frames in dense motion: the arm stopped, the gripper changed, or a command was abandoned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d

_STANDS, _AWHILE = 1e-3, 3
"""A goal stands still if it moves less than `_STANDS` [m] in `_AWHILE` samples."""
_SPRINGS = 2
"""Maximum number of samples in which a pressing arm springs back after its goal is abandoned."""
_LEVER = 0.1
"""Lever that converts a rotation to a distance [m]: the path of a point this far from the tool centre point."""


@dataclass(frozen=True)
class DenseTrajectory:
    """Samples of a motion at any rate.

    Attributes:
        pose: (T, 10) measured pose: position [m], rotation 6D, gripper opening, base frame.
        speed: (T,) measured speed of the tool centre point and a point 0.1 m from it [m/s].
        command: (T, 10) active goal at each sample.
    """

    pose: NDArray[np.float64]
    speed: NDArray[np.float64]
    command: NDArray[np.float64]

    def take(self, indices: NDArray[np.int64]) -> DenseTrajectory:
        """Returns a trajectory with a subset of the samples."""
        return DenseTrajectory(self.pose[indices], self.speed[indices], self.command[indices])


@dataclass(frozen=True)
class KeyFrameOptions:
    """Thresholds of key frames.

    Attributes:
        stopped: maximum speed of an arm at rest [m/s].
        same_place: maximum distance of poses in one place [m].
        given_up: distance above which a replaced goal counts as abandoned [m].
        reached_position: maximum distance to a reached target [m].
        reached_rotation: maximum angle to a reached target [rad].
    """

    stopped: float = 0.02
    same_place: float = 0.01
    given_up: float = 0.03
    reached_position: float = DEFAULT_MOTION.reached_position
    reached_rotation: float = DEFAULT_MOTION.reached_rotation


def distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Returns the distance between two poses (10,) [m]: translation plus rotation times 0.1 m, without gripper."""
    turn = matrix_from_rotation_6d(a[schema.ROTATION_DIMS]).T @ matrix_from_rotation_6d(b[schema.ROTATION_DIMS])
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = np.arctan2(sine, np.trace(turn) - 1.0)
    return float(np.linalg.norm(a[schema.POSITION_DIMS] - b[schema.POSITION_DIMS]) + _LEVER * angle)


def sparsify(trajectory: DenseTrajectory, options: KeyFrameOptions | None = None) -> NDArray[np.int64]:
    """Returns the indices of key frames, ascending. Idempotent.

    - The first and the last sample are key frames.
    - The last sample of a stay in one place is a key frame: arm and gripper have settled.
    - A gripper change is a key frame at the end of its stay, or at its own sample if the arm is moving.
    - A replaced goal ends a stay.
    """
    chosen = options or KeyFrameOptions()
    indices: NDArray[np.int64] = np.arange(len(trajectory.pose))
    while True:
        kept = _pass(trajectory.take(indices), chosen)
        if len(kept) == len(indices):
            return indices
        indices = indices[kept]


def _pass(trajectory: DenseTrajectory, options: KeyFrameOptions) -> NDArray[np.int64]:
    count = len(trajectory.pose)
    is_open = trajectory.pose[:, schema.GRIPPER_DIM] > 0.5  # half way: a closed gripper may hold something wide
    stay_end = _stay_ends(trajectory, is_open, options)
    kept = {0, count - 1, *stay_end[stay_end >= 0].tolist()}
    # the end of a stay also covers a gripper change within it
    kept.update(t for t in range(1, count) if is_open[t] != is_open[t - 1] and stay_end[t] < 0)
    given_up = _replaced(trajectory.pose, trajectory.command, stay_end, options)
    kept.difference_update(_late_ends(trajectory, given_up, stay_end, is_open, options))
    kept.update(given_up)
    _take_back_beginnings(kept, set(given_up), trajectory, is_open, options)
    return np.array(sorted(kept), dtype=np.int64)


def _late_ends(
    trajectory: DenseTrajectory,
    given_up: list[int],
    stay_end: NDArray[np.int64],
    is_open: NDArray[np.bool_],
    options: KeyFrameOptions,
) -> set[int]:
    """Returns ends of stays after an abandoned goal: the arm starts with a delay or springs back first."""
    pose, late, last = trajectory.pose, set[int](), len(stay_end) - 1
    for t in given_up:
        # check every sample in between: the arm may return to the same place two kept samples later
        left = t + 1
        while left <= last and _one_place(pose, is_open, t, left, options):
            left += 1
        late.update(end for end in stay_end[t : t + 1 + _SPRINGS].tolist() if 0 <= end < left)
    return late - {last}


def _take_back_beginnings(
    kept: set[int],
    given_up: set[int],
    trajectory: DenseTrajectory,
    is_open: NDArray[np.bool_],
    options: KeyFrameOptions,
) -> None:
    """Moves key frames at the start of a motion back to the change of goal, or drops them.

    An arm that leaves for a new goal is slow at first, so its speed still counts as rest. If the previous goal already
    has a key frame, e.g. at a finger change, this one is dropped.
    """
    pose, command, last = trajectory.pose, trajectory.command, len(trajectory.pose) - 1

    def changes(t: int) -> bool:
        return distance(command[t], command[t + 1]) > options.given_up

    for end in sorted(kept - given_up - {0, last}):
        soon = command[end + 1 : end + 1 + _AWHILE]
        stands = all(distance(command[end], goal) <= _STANDS for goal in soon)
        if distance(pose[end], command[end]) <= options.given_up or not stands:
            continue
        before = end - 1
        while before >= 0 and is_open[before] == is_open[end] and not changes(before):
            before = before - 1 if distance(pose[before], pose[end]) <= options.same_place else -1
        if before >= 0 and is_open[before] == is_open[end]:
            kept.discard(end)
            kept.add(before)
        elif (is_open[end : min(each for each in kept if each > end) + 1] == is_open[end]).all():
            kept.discard(end)


def _stay_ends(trajectory: DenseTrajectory, is_open: NDArray[np.bool_], options: KeyFrameOptions) -> NDArray[np.int64]:
    """Returns for each sample (T,) the last sample of its stay; -1 while the arm moves."""
    ends = np.full(len(trajectory.pose), -1, dtype=np.int64)
    start = None
    for t, speed in enumerate(trajectory.speed):
        if speed > options.stopped:
            start = None
            continue
        if start is None or not _one_place(trajectory.pose, is_open, start, t, options):
            start = t
        ends[start : t + 1] = t
    return ends


def _one_place(
    pose: NDArray[np.float64], is_open: NDArray[np.bool_], one: int, other: int, options: KeyFrameOptions
) -> bool:
    return bool(is_open[one] == is_open[other]) and distance(pose[one], pose[other]) <= options.same_place


def _replaced(
    pose: NDArray[np.float64], command: NDArray[np.float64], stay_end: NDArray[np.int64], options: KeyFrameOptions
) -> list[int]:
    """Returns the last sample before each change of goal that ends a stay or abandons a distant goal.

    Small changes do not count: in teleoperation the goal streams ahead of the arm.
    """
    return [
        t
        for t in range(len(pose) - 1)
        if distance(command[t], command[t + 1]) > options.given_up
        and (stay_end[t] >= 0 or distance(pose[t], command[t]) > options.given_up)
    ]
