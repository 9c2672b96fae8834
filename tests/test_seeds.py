"""Training, validation and test scenes never meet, whatever seeds somebody types."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.seeds import (
    BALANCED_BLOCK,
    SPLITS,
    BalancedDraws,
    Stream,
    episode_generator,
    retried_seed,
    scene_seed,
    split_of,
)
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.util.errors import ConfigurationError

ANY_SEED = st.integers(0, 2**40)


@given(st.tuples(ANY_SEED, ANY_SEED), st.permutations(sorted(SPLITS)), st.integers(1, 5))
def test_scenes_of_different_splits_differ(seeds: tuple[int, int], splits: list[str], attempt: int) -> None:
    one, other = (
        {scene_seed(seed, split), retried_seed(seed, split, attempt)}
        for seed, split in zip(seeds, splits, strict=False)
    )
    assert not one & other


@given(ANY_SEED, st.sampled_from(sorted(SPLITS)), st.integers(1, 5))
def test_a_scene_belongs_to_its_split_and_stays_what_it_is(seed: int, split: str, attempt: int) -> None:
    for scene in (scene_seed(seed, split), retried_seed(seed, split, attempt)):
        assert split_of(scene) == split
        assert scene_seed(scene, split) == scene
        assert scene < 2**31  # what simulators take


def test_seeds_that_follow_each_other_are_different_scenes() -> None:
    for split in SPLITS:
        assert len({scene_seed(seed, split) for seed in range(1000, 3000)}) == 2000


def test_retries_of_one_seed_differ_and_repeat() -> None:
    drawn = [retried_seed(7, "test", attempt) for attempt in range(1, 5)]
    assert len({7, *drawn}) == 5
    assert drawn == [retried_seed(7, "test", attempt) for attempt in range(1, 5)]


def test_an_unknown_split_is_told() -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)Unknown split.*allowed:.*test.*validation"):
        scene_seed(0, "dev")
    assert split_of(2**23) is None


def test_streams_and_categories_differ_for_equal_seeds_and_repeat() -> None:
    drawn = {
        (seed, stream, category): episode_generator(seed, stream, category).random()
        for seed in (0, 7)
        for stream in Stream
        for category in CATEGORIES
    }
    assert len(set(drawn.values())) == len(drawn)
    assert drawn[7, Stream.CAMERA, "pen"] == episode_generator(7, Stream.CAMERA, "pen").random()


def hidden(category: str, seeds: range, rules: str = "hard") -> dict[str, np.ndarray]:
    """Each hidden value of a category's episodes as numbers; a mode as three."""
    mechanism = make_mechanism(make_object(f"{category}_000"), rules)
    values = [mechanism.hidden(mechanism.draw(BalancedDraws(seed, category))) for seed in seeds]
    found = {name: np.array([float(each[name]) for each in values]) for name in values[0]}
    if "mode" in found:
        mode = found.pop("mode")
        found |= {f"mode {number}": (mode == number).astype(float) for number in range(3)}
    return found


def test_shares_of_hidden_values_are_as_declared_in_any_1000_seeds() -> None:
    shares = {"locked": (1.0, 0.5), "direction": (1.0, 0.5), "mode 0": (1.0, 1 / 3), "mode 1": (1.0, 1 / 3),
              "mode 2": (1.0, 1 / 3)}  # fmt: skip
    for category, first in itertools.product(CATEGORIES, (0, 700_000, 1_000_000 + 5)):
        for name, values in hidden(category, range(first, first + 1000)).items():
            if name in shares:
                value, share = shares[name]
                assert abs((values == value).mean() - share) <= 0.01, (category, name)
            else:  # uniform between two fractions of the object's range
                middle = (values.min() + values.max()) / 2
                assert abs((values < middle).mean() - 0.5) <= 0.01, (category, name)


def test_hidden_values_are_independent_of_each_other_and_of_other_categories() -> None:
    seeds = range(700_000, 701_000)
    columns = {(c, n): v for c in CATEGORIES for n, v in hidden(c, seeds).items() if not n.startswith("mode 2")}
    pairs = [p for p in itertools.combinations(columns, 2) if not (p[0][0] == p[1][0] == "lamp")]
    found = np.array([np.corrcoef(columns[one], columns[other])[0, 1] for one, other in pairs])
    assert np.abs(found).max() < 4.5 / np.sqrt(len(seeds)), "the largest of all pairs, within chance"
    assert found.std() < 1.2 / np.sqrt(len(seeds))


def test_each_block_of_seeds_has_each_half_equally_often() -> None:
    for block in range(50):
        values = [BalancedDraws(block * BALANCED_BLOCK + place, "pen").random() for place in range(BALANCED_BLOCK)]
        assert sorted(int(BALANCED_BLOCK * value) for value in values) == list(range(BALANCED_BLOCK))
