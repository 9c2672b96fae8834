"""Chooses the key frames of a dense episode and the accepted target that led to each."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_adamanip.recordings.sparsify import DenseTrajectory, KeyFrameOptions, distance, sparsify
from lerobot_adamanip.util.errors import DatasetError

_SHORTEST = 1e-3
"""Maximum difference of equal timestamps [s]. A recorder may read faster than the arm publishes."""
_FINGERS_BEGIN, _FINGERS_REST = 0.3, 0.01
"""Time after which commanded fingers have started to move [s], and their minimum motion per tick. Slower fingers
rest on a part wider than half of the opening."""


@dataclass(frozen=True)
class DenseEpisode:
    """A recorded episode with one row per tick.

    Attributes:
        state: (T, 24) float32 state.
        effort: (T, 7) float32 joint efforts [N m].
        sent: (T, 10) float32 last target that the arm had accepted at the row's reading.
        stamp: (T,) measurement time of the state [s].
        outcome: (T,) `lerobot_adamanip.contract.keyframes.Outcome` of the latest complete motion; -1 for none.
        success: (T,) whether the task was done.
        task: task instruction.
        asked: (T, 10) float32 action of the teleoperator or policy for the row.
        corrected: (T,) whether a person or an expert had taken over; None outside rollouts.
    """

    state: NDArray[np.float32]
    effort: NDArray[np.float32]
    sent: NDArray[np.float32]
    stamp: NDArray[np.float64]
    outcome: NDArray[np.int64]
    success: NDArray[np.bool_]
    task: str
    asked: NDArray[np.float32]
    corrected: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.state)

    def take(self, ticks: slice | NDArray[np.int64]) -> DenseEpisode:
        """Returns an episode with a subset of the ticks."""
        arrays = {name: values for name, values in vars(self).items() if isinstance(values, np.ndarray)}
        taken: dict[str, Any] = {name: values[ticks] for name, values in arrays.items()}
        return replace(self, **taken)

    @property
    def pose(self) -> NDArray[np.float64]:
        """Measured poses (T, 10): position [m], rotation 6D, gripper opening."""
        return self.state[:, : schema.ACTION_DIM].astype(np.float64)


@dataclass(frozen=True)
class ChosenKeyFrames:
    """Key frames of an episode. Each is one row of a demonstration; the last one is terminal.

    Attributes:
        rows: (K,) ticks of their observations, ascending.
        accepted: (K - 1,) ticks whose `DenseEpisode.sent` is the action of each row except the last.
        actions: (K, 10) float32; the last one keeps the tool's pose.
        outcomes: (K,) `lerobot_adamanip.contract.keyframes.Outcome` of the actions.
    """

    rows: NDArray[np.int64]
    accepted: NDArray[np.int64]
    actions: NDArray[np.float32]
    outcomes: NDArray[np.int64]


def choose_key_frames(episode: DenseEpisode, fps: int, options: KeyFrameOptions | None = None) -> ChosenKeyFrames:
    """Returns the key frames of an episode.

    Row k is observed at key frame k. Its action is the accepted target that was active when key frame k + 1 was
    reached or abandoned. The gripper is rounded to 0 or 1.

    Args:
        episode: episode of two or more ticks.
        fps: rate of the recording [Hz], for episodes with constant timestamps.
        options: thresholds.

    Raises:
        DatasetError: nothing moves in the episode.
    """
    chosen = options or KeyFrameOptions()
    grips = _grips(episode, fps)
    rows = _sent_for(episode, grips, _key_rows(episode, grips, fps, chosen))
    if len(rows) < 2:
        raise DatasetError(
            "There is nothing to learn from in an episode.",
            got=f"{len(episode)} ticks, the arm stays in one place",
            allowed="two key frames or more",
            hint="--skip-still, or lerobot-edit-dataset --operation.type=delete_episodes",
        )
    spans = itertools.pairwise(rows.tolist())
    stands = _stands(episode, fps, chosen)
    usable = stands & ((episode.sent[:, schema.GRIPPER_DIM] > 0.5) == grips)
    places = [_accepted(episode, usable & (grips == grips[last]), first, last, chosen) for first, last in spans]
    accepted = np.array(places, np.int64)
    stay = np.concatenate([episode.state[rows[-1], : schema.GRIPPER_DIM], [episode.sent[accepted[-1], -1]]])
    actions = np.concatenate([episode.sent[accepted], stay[None]]).astype(np.float32)
    actions[:, schema.GRIPPER_DIM] = actions[:, schema.GRIPPER_DIM] > 0.5
    outcomes = [_outcome(episode, at, target, chosen) for at, target in zip(rows[1:], actions[:-1], strict=True)]
    return ChosenKeyFrames(rows, accepted, actions, np.array([*outcomes, Outcome.REACHED], np.int64))


def trajectory_of(
    episode: DenseEpisode, grips: NDArray[np.bool_], fps: int
) -> tuple[DenseTrajectory, NDArray[np.int64]]:
    """Returns the input of `sparsify` and its ticks, with each reading of the arm once."""
    moments = _moments(episode, fps)
    ticks = np.flatnonzero(np.r_[True, np.diff(moments) > _SHORTEST])
    pose = episode.pose[ticks]
    pose[:, schema.GRIPPER_DIM] = grips[ticks]
    way = np.array([distance(a, b) for a, b in itertools.pairwise(pose)])
    speed = np.r_[way / np.diff(moments[ticks]), 0.0]
    # the target active after a reading is reported by the next reading
    command = episode.sent[np.r_[ticks[1:], len(episode) - 1]].astype(np.float64)
    return DenseTrajectory(pose, speed, command), ticks


def _grips(episode: DenseEpisode, fps: int) -> NDArray[np.bool_]:
    """Returns whether the hand is open, (T,): the commanded state, once the fingers are half way or at rest.

    Fingers that close on a bottle cap stay more than half open.
    """
    asked_open, opening = episode.sent[:, schema.GRIPPER_DIM] > 0.5, episode.state[:, schema.GRIPPER_DIM]
    moments, is_open = _moments(episode, fps), np.empty(len(episode), bool)
    now, since = bool(opening[0] > 0.5), 0
    for tick in range(len(episode)):
        since = tick if tick and asked_open[tick] != asked_open[tick - 1] else since
        crossed = (opening[tick] > 0.5) == asked_open[tick]
        begun = moments[tick] - moments[since] >= _FINGERS_BEGIN
        rests = begun and abs(opening[tick] - opening[tick - 1]) < _FINGERS_REST
        now = bool(asked_open[tick]) if crossed or rests else now
        is_open[tick] = now
    return is_open


def _sent_for(episode: DenseEpisode, grips: NDArray[np.bool_], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Drops key frames during a finger motion, e.g. when a hand opens after a blocked pull."""
    sent_open = episode.sent[:, schema.GRIPPER_DIM] > 0.5
    kept = [int(rows[0])]
    for row in rows[1:].tolist():
        if row == rows[-1] or (sent_open[kept[-1] + 2 : row + 1] == grips[row]).any():
            kept.append(row)
    return np.array(kept, np.int64)


def _moments(episode: DenseEpisode, fps: int) -> NDArray[np.float64]:
    """Returns each row's measurement time (T,) [s]; computed from the rate if the timestamps are constant."""
    stamps = episode.stamp
    if np.isfinite(stamps).all() and stamps[-1] - stamps[0] > _SHORTEST:
        return stamps
    return np.arange(len(episode)) / fps


def _stands(episode: DenseEpisode, fps: int, options: KeyFrameOptions) -> NDArray[np.bool_]:
    """Returns for each tick (T,) whether the accepted target has not moved since the previous reading."""
    moments, sent = _moments(episode, fps), episode.sent.astype(np.float64)
    stands, before = np.ones(len(episode), bool), 0
    for tick in range(1, len(episode)):
        while moments[tick] - moments[before + 1] > _SHORTEST and before + 1 < tick:
            before += 1
        elapsed = max(_SHORTEST, float(moments[tick] - moments[before]))
        stands[tick] = distance(sent[before], sent[tick]) <= options.stopped * elapsed
    return stands


def _key_rows(episode: DenseEpisode, grips: NDArray[np.bool_], fps: int, options: KeyFrameOptions) -> NDArray[np.int64]:
    trajectory, ticks = trajectory_of(episode, grips, fps)
    kept = sparsify(trajectory, options)
    # An arm that waits before it starts has two key frames in one place: the first sample and the end of the wait.
    waits = len(kept) > 1 and stays(trajectory.pose[kept[0] : kept[1] + 1], options.same_place)
    return ticks[kept[1:] if waits else kept]


def stays(pose: NDArray[np.float64], same_place: float) -> bool:
    """Returns whether all poses (T, 10) are in one place with the same gripper state."""
    is_open = pose[:, schema.GRIPPER_DIM] > 0.5
    return bool((is_open == is_open[0]).all()) and all(distance(pose[0], each) <= same_place for each in pose)


def _accepted(episode: DenseEpisode, usable: NDArray[np.bool_], first: int, last: int, options: KeyFrameOptions) -> int:
    """Returns the tick after ``first`` whose ``sent`` is the target of key frame ``last``.

    The arm may accept the next target before it leaves. So this is the first constant target while the arm is in its
    last place and the commanded gripper state equals the measured one.
    """
    begin, here = last, episode.pose[last]
    while begin - 1 > first and distance(episode.pose[begin - 1], here) <= options.same_place:
        begin -= 1
    return next((tick for tick in range(begin, last + 1) if usable[tick]), last)


def _outcome(episode: DenseEpisode, tick: int, target: NDArray[np.float32], options: KeyFrameOptions) -> int:
    """Returns the outcome of the motion to a target at a tick, from the arm's report or from the distance."""
    if episode.outcome[tick] >= 0:
        return int(episode.outcome[tick])
    far, turned = pose_error(*(pose_from_vector(each)[0] for each in (episode.pose[tick], target)))
    reached = far <= options.reached_position and turned <= options.reached_rotation
    return int(Outcome.REACHED if reached else Outcome.STALLED)
