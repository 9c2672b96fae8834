"""Hints say what is hidden, truly, in a share of seeds, and nothing else changes."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.datasets.collection_spec import CollectionSpec, environment_json
from lerobot_adamanip.episode.hints import LEFT, instruction
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.util.errors import ConfigurationError

SEEDS = range(1_000_000, 1_000_400)


@pytest.mark.parametrize("category", CATEGORIES)
def test_equal_hints_are_of_equal_hidden_values(category: str) -> None:
    mechanism = make_mechanism(make_object(object_id(category, 0)))
    said: dict[str, set[tuple[Any, ...]]] = {}
    for seed in range(40):
        hidden = mechanism.hidden(mechanism.draw(np.random.default_rng(seed)))
        told = tuple(hidden.get(name) for name in ("mode", "locked", "direction"))
        told = told if hidden.get("locked", True) else (None, False, None)
        said.setdefault(instruction(category, hidden, seed, 1.0), set()).add(told)
    assert all(len(values) == 1 for values in said.values()), "a hint tells one hidden state from all others"
    kinds = {"lamp": 3, "safe": 3, "pressure_cooker": 1, "coffee_maker": 1}
    assert len(said) == kinds.get(category, 2)
    assert all(text.startswith(CATEGORIES[category].instruction + " ") for text in said)


@pytest.mark.parametrize("category", LEFT)
def test_left_is_counterclockwise_as_the_hand_sees_it(category: str) -> None:
    obj = make_object(object_id(category, 0))
    key = next(joint for joint in make_mechanism(obj).joints if obj.joint(joint).limits[0] < 0)
    part = next(part for part in obj.parts if any(motion.joint == key for motion in part.motions))
    toward_hand = -part.grasp[:3, 2]
    if category == "coffee_maker":  # held from the front, turned about an upright axis
        toward_hand = np.array([0.0, 0.0, 1.0])
    assert np.sign(part.motion(key).axis @ toward_hand) == LEFT[category]


def test_a_share_of_the_seeds_has_a_hint_and_a_larger_share_keeps_it() -> None:
    hidden = {"direction": 1}
    hinted = [
        {seed for seed in SEEDS if instruction("door", hidden, seed, share) != CATEGORIES["door"].instruction}
        for share in (0.0, 0.3, 0.6, 1.0)
    ]
    assert [len(each) / len(SEEDS) for each in hinted] == pytest.approx([0.0, 0.3, 0.6, 1.0], abs=0.06)
    assert all(less <= more for less, more in itertools.pairwise(hinted))


def test_a_manifest_holds_the_share_if_there_are_hints() -> None:
    plain = CollectionSpec(EnvironmentOptions("door"), ("door_000",))
    hinted = CollectionSpec(EnvironmentOptions("door", hints=0.5), ("door_000",))
    assert set(environment_json(hinted.environment)) - set(environment_json(plain.environment)) == {"hints"}
    with pytest.raises(ConfigurationError, match="No hint exists"):
        EnvironmentOptions("microwave", mechanism_rules="changing", hints=0.5)
    EnvironmentOptions("microwave", hints=0.5)
    EnvironmentOptions("microwave", mechanism_rules="changing")
    EnvironmentOptions("door", mechanism_rules="changing", hints=0.5)
    for wrong in ({"hints": 1.5}, {"repeats": 0}):
        with pytest.raises(ConfigurationError, match="allowed:"):
            EnvironmentOptions("door", **wrong)
