"""Training, validation and test scenes never meet, whatever seeds somebody types."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.contract.seeds import SPLITS, retried_seed, scene_seed, split_of
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
