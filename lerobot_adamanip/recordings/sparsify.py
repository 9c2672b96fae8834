"""Find key frames in dense motion: where the arm stopped, the gripper changed, or a command was given up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import matrix_from_rotation_6d

_STANDS, _AWHILE = 1e-3, 3
"""A goal that moves by less than this [m] for so many samples stands still."""
_SPRINGS = 2
"""So many samples at most an arm that leaned on something takes to spring back, once its goal is given up."""
_LEVER = 0.1
"""Weighs a rotation against a translation: the way of a point this far from the tool centre point [m]."""


@dataclass(frozen=True)
class DenseTrajectory:
    """Samples of a motion at any rate.

    Attributes:
        pose: (T, 10) measured: position [m], rotation 6D, gripper opening, base frame.
        speed: (T,) measured, of tool centre point and a point 0.1 m off it [m/s].
        command: (T, 10) goal in force at each sample; None if there was none to give up.
    """

    pose: NDArray[np.float64]
    speed: NDArray[np.float64]
    command: NDArray[np.float64] | None = None

    def take(self, indices: NDArray[np.int64]) -> DenseTrajectory:
        """Returns the trajectory of some of the samples."""
        command = None if self.command is None else self.command[indices]
        return DenseTrajectory(self.pose[indices], self.speed[indices], command)


@dataclass(frozen=True)
class SparsifyOptions:
    """Thresholds.

    Attributes:
        stopped: an arm slower than this stands still [m/s].
        same_place: poses closer than this are one place [m].
        given_up: a goal replaced at a larger distance than this was given up [m].
    """

    stopped: float = 0.02
    same_place: float = 0.01
    given_up: float = 0.03


def distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Returns how far two (10,) poses are apart [m]: translation plus rotation on a lever of 0.1 m; gripper ignored."""
    turn = matrix_from_rotation_6d(a[schema.ROTATION_DIMS]).T @ matrix_from_rotation_6d(b[schema.ROTATION_DIMS])
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = np.arctan2(sine, np.trace(turn) - 1.0)
    return float(np.linalg.norm(a[schema.POSITION_DIMS] - b[schema.POSITION_DIMS]) + _LEVER * angle)


def sparsify(trajectory: DenseTrajectory, options: SparsifyOptions | None = None) -> NDArray[np.int64]:
    """Returns the indices of key frames, ascending. Applied to its own result, it changes nothing.

    - The first and the last sample are key frames.
    - Of a stay in one place the last sample is one: arm and gripper have settled.
    - A change of the gripper is kept at the end of its stay, or where it happens if the arm is moving.
    - A goal that is replaced ends a stay.
    """
    chosen = options or SparsifyOptions()
    indices: NDArray[np.int64] = np.arange(len(trajectory.pose))
    while True:
        kept = _pass(trajectory.take(indices), chosen)
        if len(kept) == len(indices):
            return indices
        indices = indices[kept]


def _pass(trajectory: DenseTrajectory, options: SparsifyOptions) -> NDArray[np.int64]:
    count = len(trajectory.pose)
    if count == 0:
        return np.arange(0)
    is_open = trajectory.pose[:, schema.GRIPPER_DIM] > 0.5  # half way: a closed gripper may hold something wide
    stay_end = _stay_ends(trajectory, is_open, options)
    kept = {0, count - 1, *stay_end[stay_end >= 0].tolist()}
    # A change of the gripper within a stay is kept by the stay's end.
    kept.update(t for t in range(1, count) if is_open[t] != is_open[t - 1] and stay_end[t] < 0)
    if trajectory.command is not None:
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
    options: SparsifyOptions,
) -> set[int]:
    """Returns ends of stays whose goal was given up before: an arm takes a while to begin, or springs back first."""
    pose, late, last = trajectory.pose, set[int](), len(stay_end) - 1
    for t in given_up:
        # Every sample in between: of samples kept before, the next but one may be where an arm has come back to.
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
    options: SparsifyOptions,
) -> None:
    """Moves key frames at which an arm has begun to move to where its goal changed, or drops them.

    An arm that leaves for another goal is slow at first: by its speed it stands still, and yet is on its way. If the
    goal before has a key frame of its own, as where the fingers changed, the one here is dropped.
    """
    pose, command, last = trajectory.pose, trajectory.command, len(trajectory.pose) - 1
    assert command is not None

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


def _stay_ends(trajectory: DenseTrajectory, is_open: NDArray[np.bool_], options: SparsifyOptions) -> NDArray[np.int64]:
    """Returns for each sample the last sample of the stay it is part of, (T,); -1 where the arm is moving."""
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
    pose: NDArray[np.float64], is_open: NDArray[np.bool_], one: int, other: int, options: SparsifyOptions
) -> bool:
    return bool(is_open[one] == is_open[other]) and distance(pose[one], pose[other]) <= options.same_place


def _replaced(
    pose: NDArray[np.float64], command: NDArray[np.float64], stay_end: NDArray[np.int64], options: SparsifyOptions
) -> list[int]:
    """Returns the last sample before each change of goal that ends a stay, or comes while the old goal is far away.

    Small changes do not count: in teleoperation a goal streams ahead of the arm.
    """
    return [
        t
        for t in range(len(pose) - 1)
        if distance(command[t], command[t + 1]) > options.given_up
        and (stay_end[t] >= 0 or distance(pose[t], command[t]) > options.given_up)
    ]
