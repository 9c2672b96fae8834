"""How well key frames are found: counted on a recording whose key frames are known."""

from __future__ import annotations

import numpy as np
from dense_helpers import FPS, STOPS, dense_episode, jumped

from lerobot_adamanip.recordings.keyframe_choice import choose_key_frames
from lerobot_adamanip.recordings.keyframe_score import Score, score

TICKS = 30


def test_what_is_driven_is_found() -> None:
    episode = dense_episode(how=lambda stops: jumped(stops, TICKS))
    chosen = choose_key_frames(episode, FPS)
    ends = np.arange(2, len(STOPS) + 1) * TICKS - 1
    assert score(episode, chosen, ends, FPS) == Score(len(ends), len(ends), len(ends), len(ends), 0)


def test_what_is_missed_invented_or_cannot_be_seen_is_counted() -> None:
    episode = dense_episode(how=lambda stops: jumped(stops, TICKS))
    chosen = choose_key_frames(episode, FPS)
    ends = np.arange(2, len(STOPS) + 1) * TICKS - 1
    # One that nobody drove, one that was driven and did not move the arm, one where the arm was on its way.
    told = np.sort(np.r_[ends[1:], ends[2] + 1, ends[4] + 4])
    found = score(episode, chosen, told, FPS)
    assert (found.known, found.found, found.matched) == (len(ends), len(ends), len(ends) - 1)
    assert (found.unmoved, found.unmoved_found) == (1, 0)
    assert found.precision == found.recall == (len(ends) - 1) / len(ends)
    assert found + found == Score(*(2 * value for value in vars(found).values()))
