"""Rates, intervals and tries: laws, not values."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import record
from scipy.stats import binomtest

from lerobot_adamanip.evaluation.metrics import (
    best_tries,
    count_tries,
    difference_interval,
    rate,
    summarise,
    tried_locked_door_first,
    wilson_interval,
    without_repeats,
)
from lerobot_adamanip.evaluation.plots import cumulative_rates
from lerobot_adamanip.evaluation.record import EpisodeRecord

SHARES = st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


RECORDS = st.lists(
    st.builds(
        record,
        seed=st.integers(0, 12),
        object_id=st.sampled_from(["safe_000", "safe_035", "safe_036", "safe_041"]),
        locked=st.booleans(),
        success=st.booleans(),
        key_frames=st.integers(1, 45),
        first_part=st.sampled_from(["handle", "knob", None]),
        blocked_pulls=st.integers(0, 4),
        key_moved=st.booleans(),
        wrong_turns=st.integers(0, 2),
    ),
    max_size=60,
)


@given(SHARES)
def test_wilson_agrees_with_scipy_and_holds_the_share(share: tuple[int, int]) -> None:
    count, episodes = share
    low, high = wilson_interval(count, episodes)
    known = binomtest(count, episodes).proportion_ci(method="wilson")
    assert (low, high) == pytest.approx((known.low, known.high), abs=1e-9)
    assert 0 <= low <= count / episodes <= high <= 1


@given(SHARES)
def test_wilson_is_symmetric_in_success_and_failure(share: tuple[int, int]) -> None:
    count, episodes = share
    low, high = wilson_interval(count, episodes)
    mirrored = wilson_interval(episodes - count, episodes)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=1e-12)


@given(SHARES, st.integers(2, 9))
def test_wilson_narrows_with_more_episodes_and_widens_with_confidence(share: tuple[int, int], times: int) -> None:
    count, episodes = share

    def width(scale: int, z: float = 1.96) -> float:
        low, high = wilson_interval(scale * count, scale * episodes, z)
        return high - low

    assert width(times) < width(1) < width(1, 2.58)


def test_no_episodes_tell_nothing() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert rate(0, 0).rate is None
    assert difference_interval(rate(0, 0), rate(3, 4)) == (0.0, -1.0, 1.0)


@pytest.mark.parametrize(("count", "episodes"), [(-1, 4), (5, 4)])
def test_impossible_counts_are_refused(count: int, episodes: int) -> None:
    with pytest.raises(ValueError, match="count must be"):
        wilson_interval(count, episodes)


@given(SHARES, SHARES)
def test_a_difference_is_antisymmetric_and_lies_in_its_interval(one: tuple[int, int], two: tuple[int, int]) -> None:
    there, back = difference_interval(rate(*one), rate(*two)), difference_interval(rate(*two), rate(*one))
    assert there[1] <= there[0] <= there[2]
    assert back == pytest.approx((-there[0], -there[2], -there[1]), abs=1e-12)


def test_only_a_real_difference_leaves_zero_out() -> None:
    _, low, high = difference_interval(rate(45, 50), rate(20, 50))
    assert low > 0
    _, low, high = difference_interval(rate(5, 10), rate(4, 10))
    assert low < 0 < high


@given(RECORDS)
def test_counts_add_up(records: list[EpisodeRecord]) -> None:
    summary = summarise(records)
    assert summary.episodes + summary.repeats == len(records)
    for one, two in (("locked", "unlocked"), ("seen", "unseen")):
        parts = [getattr(summary, one), getattr(summary, two)]
        assert sum(part.episodes for part in parts) == summary.overall.episodes == summary.episodes
        assert sum(part.count for part in parts) == summary.overall.count
    assert sum(result.episodes for result in summary.objects.values()) == summary.episodes
    failures = summary.overall.episodes - summary.overall.count
    assert sum(result.failures for result in summary.objects.values()) == failures
    assert summary.tried_locked_door_first.episodes == summary.locked.episodes
    assert (summary.key_frames_of_successes is None) == (summary.overall.count == 0)


@given(RECORDS)
def test_an_episode_counts_once_and_the_last_record_wins(records: list[EpisodeRecord]) -> None:
    kept = without_repeats(records)
    assert max(Counter(r.identity for r in kept).values(), default=1) == 1
    assert {r.identity for r in kept} == {r.identity for r in records}
    assert all(kept_one is [r for r in records if r.identity == kept_one.identity][-1] for kept_one in kept)
    twice = summarise([*records, *records])
    assert twice.episodes == summarise(records).episodes
    assert twice.overall == summarise(records).overall


def test_one_seed_on_two_objects_or_with_another_hidden_state_is_two_episodes() -> None:
    assert summarise([record(), record(object_id="safe_001"), record(locked=True)]).episodes == 3


@given(RECORDS)
def test_order_does_not_matter_without_repeats(records: list[EpisodeRecord]) -> None:
    kept = without_repeats(records)
    forward, backward = summarise(kept), summarise(kept[::-1])
    assert forward.overall == backward.overall
    assert forward.objects == backward.objects
    assert forward.tries.wasted == pytest.approx(backward.tries.wasted)


def test_trying_the_locked_door_first_needs_a_lock_the_handle_and_a_pull() -> None:
    assert tried_locked_door_first(record(locked=True, blocked_pulls=1))
    assert not tried_locked_door_first(record(blocked_pulls=1))
    assert not tried_locked_door_first(record(locked=True, blocked_pulls=1, first_part="knob"))
    assert not tried_locked_door_first(record(locked=True))
    assert not tried_locked_door_first(record(locked=True, blocked_pulls=1, first_try_failed=False))


def test_the_best_strategy_wastes_nothing_and_each_further_try_one() -> None:
    # Of two locked safes, the best strategy turns one knob the wrong way first.
    lucky = record(seed=2, locked=True, blocked_pulls=1, key_moved=True)
    unlucky = record(seed=3, locked=True, blocked_pulls=1, key_moved=True, wrong_turns=1)
    assert count_tries([record(), lucky, unlucky]).wasted == pytest.approx(0)
    for more in ({"locked": True, "blocked_pulls": 1}, {"key_moved": True}, {"wrong_turns": 1}):
        worse = [record(**({"blocked_pulls": 0} | more)), record()]
        excess = count_tries(worse).made - count_tries([record(), record()]).made
        assert excess == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("hidden", "best"),
    [
        ({"locked": False}, 0.0), ({"locked": True}, 1.0), ({"locked": False, "direction": 1}, 0.0),
        ({"locked": True, "direction": 1}, 1.5), ({"direction": -1, "turn_range": 1.1}, 0.5), ({"mode": 2}, 1.0),
    ],
)  # fmt: skip
def test_knowing_nothing_costs_what_the_hidden_values_say(hidden: dict[str, object], best: float) -> None:
    assert best_tries(record(hidden_state=hidden)) == best


def test_each_category_has_a_rate_of_its_own() -> None:
    names = ("safe_000", "safe_001", "lamp_003", "pressure_cooker_002")
    summary = summarise([record(object_id=name, success=name != "safe_001") for name in names])
    assert {name: (r.count, r.episodes) for name, r in summary.categories.items()} == {
        "safe": (1, 2),
        "lamp": (1, 1),
        "pressure_cooker": (1, 1),
    }
    assert sum(r.count for r in summary.categories.values()) == summary.overall.count


@given(RECORDS)
def test_the_curve_ends_at_the_overall_rate(records: list[EpisodeRecord]) -> None:
    rates = cumulative_rates(records)
    assert [r.episodes for r in rates] == list(range(1, summarise(records).episodes + 1))
    if rates:
        assert rates[-1] == summarise(records).overall
