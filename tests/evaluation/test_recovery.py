"""What is tried after something has failed."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import record

from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.recovery import recovery

PULL, LEFT, RIGHT = (0, 1), (1, 1), (1, -1)


def episode(*tries: Any, seed: int = 1) -> EpisodeRecord:
    """An episode of tries ``(joint, sign, failed)``."""
    pulls, turns = (sum(failed for joint, _, failed in tries if (joint > 0) == key) for key in (False, True))
    counts = {"tries": len(tries), "blocked_pulls": pulls, "wrong_turns": turns}
    part = "handle" if tries else None
    return record(seed=seed, key_frames=30, first_part=part, try_sequence=tries, **counts)


def test_a_good_episode_repeats_nothing_that_failed() -> None:
    found = recovery([episode((*PULL, True), (*LEFT, True), (*RIGHT, False), (*RIGHT, False), (*PULL, False))])
    assert (found.repeated.count, found.repeated.episodes) == (0, 2)
    assert {count: (rate.count, rate.episodes) for count, rate in found.untried.items()} == {1: (1, 1), 2: (1, 1)}


def test_alternating_between_two_that_failed_repeats_neither_and_is_nothing_new() -> None:
    found = recovery([episode((*LEFT, True), (*RIGHT, True), (*LEFT, True), (*RIGHT, True), (*LEFT, True))])
    assert found.repeated.count == 0
    assert (found.untried[1].count, found.untried[1].episodes) == (1, 1)
    assert (found.untried[2].count, found.untried[2].episodes) == (0, 3)


def test_the_same_again_is_a_repeat() -> None:
    found = recovery([episode((*PULL, True), (*PULL, True), (*PULL, False))])
    assert (found.repeated.count, found.repeated.episodes) == (2, 2)
    assert found.untried[1].count == 0


def test_what_failed_may_be_tried_again_once_something_has_moved() -> None:
    found = recovery([episode((*PULL, True), (*LEFT, False), (*PULL, False))])
    assert (found.repeated.count, found.repeated.episodes) == (0, 1)
    assert found.untried[1].count == found.untried[1].episodes == 1


TRIES = st.lists(st.tuples(st.integers(0, 2), st.sampled_from((-1, 1)), st.booleans()), max_size=12)


@given(st.lists(TRIES, max_size=4))
def test_episodes_are_counted_apart(sequences: list[list[tuple[int, int, bool]]]) -> None:
    episodes = [episode(*tries, seed=seed) for seed, tries in enumerate(sequences)]
    together, apart = recovery(episodes), [recovery([each]) for each in episodes]
    assert together.repeated.count == sum(each.repeated.count for each in apart)
    assert together.repeated.episodes == sum(each.repeated.episodes for each in apart)
    assert sum(rate.episodes for rate in together.untried.values()) == together.repeated.episodes
    # What is repeated has failed: it is nothing new.
    assert sum(rate.count for rate in together.untried.values()) <= together.repeated.episodes - together.repeated.count


def test_a_record_whose_sequence_contradicts_its_counts_is_refused() -> None:
    content = dataclasses.replace(record(), try_sequence=((0, 1, True),)).to_json()
    with pytest.raises(ValueError, match="try_sequence"):
        EpisodeRecord.from_json(content)
    whole = episode((*PULL, True), (*LEFT, False))
    assert EpisodeRecord.from_json(whole.to_json()) == whole
    assert json.loads(json.dumps(whole.to_json())) == whole.to_json()
