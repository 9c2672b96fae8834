"""Two policies in the same scenes: the difference, its interval, and what each training says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import record

from lerobot_adamanip.evaluation.paired import OPENED, WITHIN_TRIES, failed_tries, outcomes, paired_difference
from lerobot_adamanip.evaluation.rates import difference, rate

digits = st.text("012", min_size=40, max_size=40)


def test_outcomes_are_in_the_order_of_the_seeds() -> None:
    within, opened = record(given_seed=7), record(given_seed=3, blocked_pulls=4)
    failed = record(given_seed=5, success=False, wrong_turns=12)
    assert outcomes([within, failed, opened]) == "102"
    assert failed_tries([within, failed, opened]) == "490"


@given(digits, digits, digits, digits)
def test_it_is_the_difference_of_the_rates_and_has_two_sides(a: str, b: str, c: str, d: str) -> None:
    for least in (OPENED, WITHIN_TRIES):
        there = paired_difference({1: [(a, b)], 2: [(c, d)]}, least)
        back = paired_difference({1: [(b, a)], 2: [(d, c)]}, least)
        shares = [np.mean([each >= least for each in text]) for text in (a + c, b + d)]
        assert there.difference == pytest.approx(shares[0] - shares[1])
        assert (back.difference, back.low, back.high) == pytest.approx((-there.difference, -there.high, -there.low))
        assert there.low <= there.difference <= there.high
        assert np.mean(list(there.by_training.values())) == pytest.approx(there.difference)


def test_scenes_that_both_open_do_not_widen_it() -> None:
    """Both policies fail in the hard scenes: paired, a small gain is certain; unpaired, it is not."""
    first, second = "2" * 60 + "0" * 40, "2" * 50 + "0" * 50
    paired = paired_difference({1: [(first, second)]}, OPENED)
    assert paired.low > 0 > difference(rate(60, 100), rate(50, 100)).low


@pytest.mark.parametrize("categories", [1, 9])
@pytest.mark.parametrize(("first_alone", "second_alone"), [(0.2, 0.05), (0.02, 0.01), (0.1, 0.1)])
def test_its_interval_covers_the_truth(first_alone: float, second_alone: float, categories: int) -> None:
    generator, true, covered = np.random.default_rng(0), first_alone - second_alone, 0
    shares = [0.5, first_alone, second_alone, 0.5 - first_alone - second_alone]
    for _ in range(400):
        scenes = generator.choice(4, size=(categories, 100), p=shares)  # opened by both, the first, the second, none
        texts = [np.where(np.isin(scenes, by), "2", "0") for by in ((0, 1), (0, 2))]
        found = paired_difference({1: [("".join(a), "".join(b)) for a, b in zip(*texts, strict=True)]}, OPENED)
        covered += found.low <= true <= found.high
    assert covered / 400 > 0.92


def test_agreement_is_not_certainty() -> None:
    same = paired_difference({1: [("2" * 60, "2" * 60)]}, OPENED)
    assert same.difference == 0.0
    assert same.high == -same.low > 0.02
    assert paired_difference({1: [("2", "0")]}, OPENED).low == -1.0, "one scene says nothing"


def test_equal_seeds_of_several_categories_are_one_scene() -> None:
    apart = paired_difference({1: [("2200", "2000"), ("1111", "0000")]}, OPENED)
    assert apart.difference == 5 / 8
    assert apart.by_training == {1: 5 / 8}
    once, twice = (paired_difference({1: [("2200", "2000")] * count}, OPENED) for count in (1, 2))
    assert twice.by_training == once.by_training
    assert once.low < twice.low < twice.high < once.high


def test_episodes_in_a_row_that_play_one_scene_are_one_scene() -> None:
    pairs = [("22010", "20001"), ("11100", "01010")]
    thrice = [tuple("".join(3 * digit for digit in digits) for digits in pair) for pair in pairs]
    once = paired_difference({1: pairs}, OPENED)
    assert paired_difference({1: thrice}, OPENED, repeats=3) == once  # type: ignore[list-item]
    narrow = paired_difference({1: thrice}, OPENED)  # type: ignore[list-item]
    assert narrow.high - narrow.low < once.high - once.low


def test_a_small_difference_over_many_categories_is_seen() -> None:
    """Each category has other scenes in which the first policy alone succeeds, two of a hundred."""
    second = ["2" * (98 - 10 * each) + "00" + "2" * (10 * each) for each in range(9)]
    assert paired_difference({1: [("2" * 100, each) for each in second]}, OPENED).low > 0
