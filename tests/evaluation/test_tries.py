"""Classification of tries: what failed ones failed at, what follows them, and how failed episodes ended."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import record

from lerobot_adamanip.evaluation.metrics import (
    AJAR,
    KEY_HELD,
    KEY_MOVED,
    NO_FURTHER,
    NO_TRY,
    NOTHING_MOVED,
    PART_HELD,
    count_tries,
    failed_at,
    failure_cause,
    measure,
    recovery,
    tried_locked_first,
    wasted_tries,
    within_best_tries,
    within_own_tries,
)
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.record import EpisodeRecord, TryMade

PULL, PULLED = (0, 1, True), (0, 1, False)
LEFT, TURNED, RIGHT = (1, 1, True), (1, 1, False), (1, -1, True)


def episode(*tries: TryMade, seed: int = 1, **changes: Any) -> EpisodeRecord:
    """An episode of tries ``(joint, sign, failed)``."""
    return record(**{"seed": seed, "key_frames": 30, "try_sequence": tries, **changes})


def failed(*tries: TryMade, door: float = 0.0, **changes: Any) -> EpisodeRecord:
    return episode(*tries, success=False, joints={"door": door, "knob": 0.0}, **changes)


def test_failed_episodes_are_told_by_how_far_they_came() -> None:
    causes = {
        NO_TRY: [failed(seed=1)],
        NOTHING_MOVED: [failed(PULL, seed=2)],
        KEY_MOVED: [failed(PULL, TURNED, seed=3)],
        AJAR: [failed(PULL, TURNED, seed=4, door=0.2), failed(PULL, seed=5, door=-0.2)],
        None: [episode(PULLED, seed=6)],
    }
    for cause, records in causes.items():
        assert [failure_cause(each) for each in records] == [cause] * len(records)
    metrics = measure([each for records in causes.values() for each in records])
    assert metrics.show("failures") == "no try 1, tried in vain 1, key moved 1, ajar 2"


@pytest.mark.parametrize(
    ("sequence", "found"),
    [
        ((), []),
        ((TURNED, PULLED), []),
        ((PULL, LEFT, RIGHT), [PART_HELD, KEY_HELD, KEY_HELD]),
        ((LEFT, RIGHT, TURNED, LEFT), [KEY_HELD, KEY_HELD, NO_FURTHER]),
        ((TURNED, RIGHT, PULL), [KEY_HELD, PART_HELD]),
        ((PULLED, PULL, TURNED, LEFT), [NO_FURTHER]),
    ],
)
def test_a_failed_try_is_told_by_its_joint_and_by_whether_it_had_moved_that_way(
    sequence: tuple[TryMade, ...], found: list[str]
) -> None:
    assert list(failed_at(record(try_sequence=sequence))) == found


def test_what_tries_failed_at_is_told_per_success() -> None:
    records = [
        episode(PULL, LEFT, TURNED, PULLED, seed=1),
        episode(PULL, TURNED, PULLED, seed=2),
        failed(PULL, LEFT, RIGHT, seed=3),
    ]
    assert measure(records).show("failed_at") == "part held 1.00, key held 0.50"


@pytest.mark.parametrize(
    ("tries", "repeated", "untried"),
    [
        ((PULL, LEFT, (1, -1, False), (1, -1, False), PULLED), (0, 2), {1: (1, 1), 2: (1, 1)}),
        ((LEFT, RIGHT, LEFT, RIGHT, LEFT), (0, 4), {1: (1, 1), 2: (0, 3)}),  # to and fro is nothing new
        ((PULL, PULL, PULLED), (2, 2), {1: (0, 2)}),
        ((PULL, TURNED, PULLED), (0, 1), {1: (1, 1)}),  # a failure is forgotten once something has moved
    ],
)
def test_repeats_and_new_tries_are_told(
    tries: tuple[TryMade, ...], repeated: tuple[int, int], untried: dict[int, tuple[int, int]]
) -> None:
    found = recovery([episode(*tries)])
    assert (found.repeated.count, found.repeated.episodes) == repeated
    assert {count: (each.count, each.episodes) for count, each in found.untried.items()} == untried


TRIES = st.lists(st.tuples(st.integers(0, 1), st.sampled_from((-1, 1)), st.booleans()), max_size=12)


@given(st.lists(TRIES, max_size=4))
def test_episodes_are_counted_apart(sequences: list[list[TryMade]]) -> None:
    episodes = [episode(*tries, seed=seed) for seed, tries in enumerate(sequences)]
    together, apart = recovery(episodes), [recovery([each]) for each in episodes]
    assert together.repeated.count == sum(each.repeated.count for each in apart)
    assert together.repeated.episodes == sum(each.repeated.episodes for each in apart)
    assert sum(rate.episodes for rate in together.untried.values()) == together.repeated.episodes
    # A repeated try has failed before, so it is nothing new.
    assert sum(rate.count for rate in together.untried.values()) <= together.repeated.episodes - together.repeated.count


@given(TRIES)
def test_what_stalls_after_the_part_has_given_way_is_not_counted(tries: list[TryMade]) -> None:
    first = next((place for place, (joint, _, fails) in enumerate(tries) if joint == 0 and not fails), len(tries))
    made = episode(*tries)
    assert made.counted_tries[:first] == tuple(tries[:first])
    assert list(made.counted_tries[first:]) == [each for each in tries[first:] if each[0] > 0 or not each[2]]
    assert made.failed_tries == sum(fails for _, _, fails in made.counted_tries)
    assert EpisodeRecord.from_json(made.to_json()) == made, "a log keeps all of them"


@pytest.mark.parametrize(
    ("rules", "second", "third", "counted"),
    [("row", True, False, 2), ("row", True, True, 0), ("row", False, True, 0), ("paper", True, False, 0)],
)
def test_a_part_at_a_notch_has_not_given_way(rules: str, second: bool, third: bool, counted: int) -> None:
    tries = ((1, 1, False), PULLED, PULL, PULL, (1, -1, False), PULLED, PULL)
    made = episode(*tries, hidden_state={"direction": 1, "second_pulls": second, "third_pulls": third})
    made = replace(made, provenance=replace(made.provenance, mechanism_rules=rules))
    assert made.failed_tries == counted


def test_trying_the_locked_door_first_needs_a_lock_the_handle_and_a_failed_pull() -> None:
    pull = {"locked": True, "blocked_pulls": 1}
    assert tried_locked_first(record(**pull))
    for changes in ({"blocked_pulls": 1}, {"locked": True, "wrong_turns": 1}, {"locked": True}):
        assert not tried_locked_first(record(**changes))


@pytest.mark.parametrize(
    ("hidden", "best"),
    [
        ({"locked": False}, 0.0), ({"locked": True}, 1.0), ({"locked": False, "direction": 1}, 0.0),
        ({"locked": True, "direction": 1}, 1.5), ({"direction": -1, "turn_range": 1.1}, 0.5), ({"mode": 2}, 1.0),
    ],
)  # fmt: skip
def test_the_best_blind_strategy_pays_for_what_is_hidden(hidden: dict[str, object], best: float) -> None:
    one = record(hidden_state=hidden)
    assert count_tries(one) - wasted_tries(one) == best


def test_a_direction_that_never_changes_costs_nothing() -> None:
    cookers = [record(object_id="pressure_cooker_000", mechanism_rules=name) for name in ("paper", "hard")]
    assert [count_tries(one) - wasted_tries(one) for one in cookers] == [0.0, 0.5]


@pytest.mark.parametrize(
    ("hidden", "allowed"),
    [
        ({"turn_range": 1.1}, 0),
        ({"direction": -1, "turn_range": 1.1}, 1),
        ({"locked": False, "direction": 1}, 2),
        ({"locked": True, "direction": 1, "knob_range": 1.2}, 2),
        ({"mode": 0}, 2),
    ],
)
def test_a_success_counts_with_the_failed_tries_of_the_best_blind_strategy(
    hidden: dict[str, object], allowed: int
) -> None:
    def opened(failures: int, **changes: Any) -> EpisodeRecord:
        return episode(*[PULL] * failures, PULLED, hidden_state=hidden, **changes)

    assert within_best_tries(opened(allowed))
    assert not within_best_tries(opened(allowed + 1))
    assert not within_best_tries(opened(0, success=False))
    own = 0 if hidden.get("locked") is False else allowed
    assert within_own_tries(opened(own))
    assert not within_own_tries(opened(own + 1))
    assert measure([opened(failures, seed=failures) for failures in range(4)]).within_best_tries == rate(allowed + 1, 4)
