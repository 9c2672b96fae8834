"""Rates and intervals: laws, not values."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from lerobot_adamanip.evaluation.rates import Difference, difference, rate, wilson_interval

SHARES = st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


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
