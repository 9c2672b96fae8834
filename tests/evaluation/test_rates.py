"""Rates and intervals: laws, not values."""

from __future__ import annotations

import dataclasses
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.evaluation.rates import (
    SUCCESS_KEYS,
    Difference,
    difference,
    rate,
    success_summary,
    wilson_interval,
)

SHARES = st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@given(SHARES)
def test_wilson_holds_the_share_and_is_symmetric_in_success_and_failure(share: tuple[int, int]) -> None:
    count, episodes = share
    low, high = wilson_interval(count, episodes)
    assert 0 <= low <= count / episodes <= high <= 1
    mirrored = wilson_interval(episodes - count, episodes)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=1e-12)


def test_no_episodes_tell_nothing() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert rate(0, 0).rate is None
    assert difference(rate(0, 0), rate(3, 4)) == Difference(0.0, -1.0, 1.0)


@pytest.mark.parametrize(("count", "episodes"), [(-1, 4), (5, 4)])
def test_impossible_counts_are_refused(count: int, episodes: int) -> None:
    with pytest.raises(ValueError, match="count must be"):
        wilson_interval(count, episodes)


@given(SHARES, SHARES)
def test_a_difference_is_antisymmetric_and_lies_in_its_interval(one: tuple[int, int], two: tuple[int, int]) -> None:
    there, back = difference(rate(*one), rate(*two)), difference(rate(*two), rate(*one))
    assert there.low <= there.difference <= there.high
    assert dataclasses.astuple(back) == pytest.approx((-there.difference, -there.high, -there.low), abs=1e-12)


def test_only_a_real_difference_leaves_zero_out() -> None:
    assert difference(rate(45, 50), rate(20, 50)).low > 0
    gap = difference(rate(5, 10), rate(4, 10))
    assert gap.low < 0 < gap.high


@pytest.mark.parametrize(
    ("count", "episodes", "interval"),
    [(7, 10, [39.68, 89.22]), (9, 10, [59.58, 98.21]), (14, 20, [48.10, 85.45]), (14, 30, [30.23, 63.86])],
)
def test_a_rate_has_lerobots_keys_and_values(count: int, episodes: int, interval: list[float]) -> None:
    """Values of LeRobot's tests of `lerobot.utils.eval_stats` and of its `eval_policy_all`, pull request 4628."""
    told = success_summary(rate(count, episodes))
    assert (told["n_success"], told["n_episodes"]) == (count, episodes)
    assert told["pc_success"] == pytest.approx(100 * count / episodes)
    assert told["pc_success_ci95"] == pytest.approx(interval, abs=0.05)


def test_lerobots_keys_of_no_episodes_are_json() -> None:
    told = json.dumps(success_summary(rate(0, 0)), allow_nan=False)
    assert json.loads(told) == dict(zip(SUCCESS_KEYS, (0, 0, None, [None, None]), strict=True))
