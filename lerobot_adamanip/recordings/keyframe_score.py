"""Compare the key frames that were found in a recording with those that were driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.recordings.keyframe_choice import ChosenKeyFrames, DenseEpisode, KeyFrameOptions, stays
from lerobot_adamanip.recordings.sparsify import distance

SECONDS = 0.4
"""Largest time between a key frame's end and the tick that was found for it [s]."""


@dataclass(frozen=True)
class Score:
    """Counts over episodes; they add up.

    Attributes:
        known: key frames that were driven, and moved something.
        found: that were found in the recording.
        matched: of both.
        same_action: matched ones whose action is the target that was in force, in float32, the gripper made 0 or 1.
        unmoved: key frames that moved neither arm nor fingers, as a pull that is blocked at once.
        unmoved_found: of these, that were found.
    """

    known: int = 0
    found: int = 0
    matched: int = 0
    same_action: int = 0
    unmoved: int = 0
    unmoved_found: int = 0

    def __add__(self, other: Score) -> Score:
        return Score(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))

    @property
    def precision(self) -> float:
        """Share of found key frames that were driven."""
        return (self.matched + self.unmoved_found) / max(1, self.found)

    @property
    def recall(self) -> float:
        """Share of known key frames that are found."""
        return self.matched / max(1, self.known)


def score(episode: DenseEpisode, chosen: ChosenKeyFrames, ends: NDArray[np.int64], fps: int) -> Score:
    """Compares the key frames that were found in an episode with those that were driven.

    Args:
        episode: the recording.
        chosen: what was found; its first row is where the episode begins, and no key frame's end.
        ends: (K,) ticks at which key frames had ended.
        fps: of the recording [Hz].
    """
    options = KeyFrameOptions()
    begins = np.r_[0, ends[:-1]]
    spans = [episode.pose[begin : end + 1] for begin, end in zip(begins, ends, strict=True)]
    moved = [number for number, span in enumerate(spans) if not stays(span, options.sparsify.same_place)]
    unmoved = [number for number in range(len(ends)) if number not in moved]
    free = list(zip(chosen.rows[1:].tolist(), chosen.actions[:-1], strict=True))
    pairs: dict[int, NDArray[np.float32]] = {}
    for number in (*moved, *unmoved):
        end = int(ends[number])
        near = [place for place, (row, _) in enumerate(free) if _is_it(episode, row, end, fps, options)]
        if near:
            pairs[number] = free.pop(min(near, key=lambda place: abs(free[place][0] - end)))[1]
    same = 0
    for number in set(pairs) & set(moved):
        wanted = episode.asked[ends[number] - 1].copy()  # what was in force during its last tick
        wanted[schema.GRIPPER_DIM] = wanted[schema.GRIPPER_DIM] > 0.5
        same += bool((pairs[number] == wanted).all())
    matched = len(set(pairs) & set(moved))
    return Score(len(moved), len(chosen.rows) - 1, matched, same, len(unmoved), len(pairs) - matched)


def _is_it(episode: DenseEpisode, row: int, end: int, fps: int, options: KeyFrameOptions) -> bool:
    here, there = episode.pose[row], episode.pose[end]
    fingers = (here[schema.GRIPPER_DIM] > 0.5) == (there[schema.GRIPPER_DIM] > 0.5)
    return bool(abs(row - end) <= SECONDS * fps and fingers and distance(here, there) <= options.sparsify.same_place)
