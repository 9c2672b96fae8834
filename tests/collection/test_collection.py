from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import pytest
from demos_helpers import make_spec
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.contract.seeds import SPLITS, split_of
from lerobot_adamanip.datasets.collection_spec import (
    DEMO_SEED_END,
    DEMO_SEED_START,
    DENSE_FIELDS,
    MANIFEST_FIELDS,
    OPTIONAL_FIELDS,
    episode_seed,
)
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError

Refuses = Callable[[type, Callable[[], Any]], str]
RUNTIME_FIELDS = (
    "category", "objects", "assets", "split", "seed_offset", "render_backend", "episode_log", "run_id", "run_label",
    "logged_seeds", "repeats",
)  # fmt: skip
"""Other options: category and objects have their own fields, the split is constant, paths are local, runs and
repeats belong to evaluations, and its versions cover the renderer."""


@given(st.integers(0, 2**32), st.integers(0, 1000), st.integers(0, 50))
def test_demo_seeds_never_meet_evaluation_seeds(seed: int, slot: int, attempt: int) -> None:
    value = episode_seed(seed, "safe", "safe_000", slot, attempt)
    assert DEMO_SEED_START <= value < DEMO_SEED_END
    assert split_of(value) == "train"
    assert all(end <= DEMO_SEED_START for name, (_, end) in SPLITS.items() if name != "train")


def test_every_place_in_a_collection_has_a_seed_of_its_own() -> None:
    places = [
        (s, "safe", f"safe_{o:03d}", k, a) for s in range(2) for o in range(36) for k in range(20) for a in range(2)
    ]
    assert len({episode_seed(*place) for place in places}) == len(places)


def test_a_prefix_of_a_collection_is_balanced_and_a_longer_one_starts_with_a_shorter() -> None:
    items = make_spec(episodes_per_object=3).items()
    assert make_spec(episodes_per_object=5).items()[: len(items)] == items
    assert [item.object_id for item in items[:2]] == ["safe_000", "safe_001"]
    assert len({item.file_name for item in items}) == len(items)


def test_every_option_of_an_environment_is_in_the_manifest_or_said_not_to_be() -> None:
    """An option that is added and decides data has to be written down, or datasets cannot tell it."""
    written = {*MANIFEST_FIELDS, *DENSE_FIELDS, *OPTIONAL_FIELDS}
    assert {*written, *RUNTIME_FIELDS} == {item.name for item in fields(EnvironmentOptions)}
    assert not set(MANIFEST_FIELDS) & set(RUNTIME_FIELDS)


@pytest.mark.parametrize(
    "changes",
    [
        {"expert": "clairvoyant"}, {"expert_strategy": "x"}, {"episodes_per_object": 0}, {"num_points": -1},
        {"trials": 0}, {"objects": ("safe_000", "safe_000")}, {"objects": ("teapot_000",)}, {"late_starts": 1.5},
        {"late_starts": float("nan")}, {"episodes_per_object": 10**9}, {"seed": -1}, {"image_size": 3},
        {"poses": "paper"},
    ],
)  # fmt: skip
def test_impossible_options_are_refused(refuses: Refuses, changes: dict[str, Any]) -> None:
    refuses(ConfigurationError, lambda: make_spec(**changes))
