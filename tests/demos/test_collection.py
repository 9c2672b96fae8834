from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.demos.collection import (
    DEMO_SEED_END,
    DEMO_SEED_START,
    CollectionSpec,
    episode_seed,
    read_manifest,
    require_same,
    write_manifest,
)
from lerobot_adamanip.errors import ConfigurationError, DatasetError

EVALUATION_SEEDS_END = 1_000_000
Options = Callable[..., CollectionSpec]
Refuses = Callable[[type, Callable[[], Any]], str]


@given(st.integers(0, 2**32), st.integers(0, 1000), st.integers(0, 50))
def test_demo_seeds_never_meet_evaluation_seeds(seed: int, slot: int, attempt: int) -> None:
    value = episode_seed(seed, "safe", "safe_000", slot, attempt)
    assert EVALUATION_SEEDS_END < DEMO_SEED_START <= value < DEMO_SEED_END


def test_every_place_in_a_collection_has_a_seed_of_its_own() -> None:
    places = [
        (s, "safe", f"safe_{o:03d}", k, a) for s in range(2) for o in range(36) for k in range(20) for a in range(2)
    ]
    assert len({episode_seed(*place) for place in places}) == len(places)


def test_a_prefix_of_a_collection_is_balanced_and_a_longer_one_starts_with_a_shorter(options: Options) -> None:
    items = options(episodes_per_object=3).items()
    assert options(episodes_per_object=5).items()[: len(items)] == items
    assert [item.object_id for item in items[:2]] == ["fake_000", "fake_001"]
    assert len({item.file_name for item in items}) == len(items)


def test_options_survive_the_disk(tmp_path: Path, options: Options) -> None:
    wanted = options(env_options={"locked": None, "probability": 0.5})
    write_manifest(tmp_path / "m", wanted)
    assert read_manifest(tmp_path / "m") == wanted


def test_differences_are_named(tmp_path: Path, options: Options, refuses: Refuses) -> None:
    stored, wanted = options(), options(seed=1, num_points=9)
    message = refuses(DatasetError, lambda: require_same(stored, wanted, tmp_path))
    assert "num_points = 9" in message
    assert "seed = 1" in message
    assert "image_size" not in message
    require_same(stored, options(), tmp_path)


def test_a_damaged_manifest_is_one_clear_error(tmp_path: Path, refuses: Refuses) -> None:
    for text in ("", "[]", "{}", '{"objects": 3}'):
        (tmp_path / "m").write_text(text)
        refuses(DatasetError, lambda: read_manifest(tmp_path / "m"))


@pytest.mark.parametrize(
    "changes",
    [{"expert": "clairvoyant"}, {"episodes_per_object": 0}, {"num_points": -1}, {"trials": 0}, {"objects": ()},
     {"objects": ("fake_000", "fake_000")}],
)  # fmt: skip
def test_impossible_options_are_refused(options: Options, refuses: Refuses, changes: dict[str, Any]) -> None:
    refuses(ConfigurationError, lambda: options(**changes))
