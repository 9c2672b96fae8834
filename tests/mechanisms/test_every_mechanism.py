"""Every mechanism is pure and reproducible, and every category has one that its objects can play."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_joints import CAP, LAMP, MECHANISMS, MICROWAVE, SAFE, drawn, generator, rest

from lerobot_adamanip.catalog import make_object, seen_objects
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.mechanisms import (
    LampMechanism,
    Mechanism,
    MicrowaveMechanism,
    SafeMechanism,
    TurnToOpenMechanism,
    fixed_direction,
    make_mechanism,
    rules_of,
)
from lerobot_adamanip.util.errors import ConfigurationError

ONE_LOCK = ("paper", "upstream", "hard")
"""Rules that every category has."""
every_mechanism = pytest.mark.parametrize("mechanism", MECHANISMS.values(), ids=MECHANISMS)


def random_positions(mechanism: Mechanism[Any], seed: int) -> dict[str, float]:
    """Anything between well below and well above what each joint can do."""
    return dict(zip(mechanism.joints, np.random.default_rng(seed).uniform(-1.5, 1.5, 2).tolist(), strict=True))


@every_mechanism
def test_a_step_is_pure_and_leaves_the_hidden_draw_and_rest_alone(mechanism: Mechanism[Any]) -> None:
    for number, state in enumerate(drawn(mechanism, 8)):
        hidden = mechanism.hidden(state)
        for step in range(6):
            positions = random_positions(mechanism, 10 * number + step)
            before = copy.deepcopy((state, positions))
            following, limits = mechanism.step(state, positions)
            assert (following, limits) == mechanism.step(state, positions)
            assert (state, positions) == before
            assert set(limits) == set(mechanism.joints)
            assert all(lower <= 0 <= upper for lower, upper in limits.values()), "at rest no joint is pushed anywhere"
            state = following  # noqa: PLW2901
        assert mechanism.hidden(state) == hidden


@every_mechanism
@given(st.integers(0, 2**31 - 2))
@settings(max_examples=20, deadline=None)
def test_equal_seeds_give_equal_draws_and_hidden_values_reproduce_an_episode(
    mechanism: Mechanism[Any], seed: int
) -> None:
    state = mechanism.draw(generator(seed))
    assert state == mechanism.draw(generator(seed))
    hidden = json.loads(json.dumps(mechanism.hidden(state)))
    assert mechanism.draw(generator(seed + 1), hidden) == state, "nothing is hidden beside what is told"


@every_mechanism
def test_a_value_fixed_by_name_changes_no_other(mechanism: Mechanism[Any]) -> None:
    values = {"locked": True, "direction": -1, "turn_range": 0.9, "knob_range": 1.3, "mode": 2}
    for name in mechanism.hidden_names:
        for seed in range(16):
            free, fixed = generator(seed), generator(seed)
            one, other = mechanism.draw(free), mechanism.draw(fixed, {name: values[name]})
            assert mechanism.hidden(other) == mechanism.hidden(one) | {name: values[name]}
            assert free.bit_generator.state == fixed.bit_generator.state


@every_mechanism
def test_a_name_it_does_not_have_is_refused_with_those_it_has(mechanism: Mechanism[Any]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        mechanism.draw(generator(), {"lokced": True})
    assert all(name in str(caught.value) for name in (*mechanism.hidden_names, "lokced"))


IMPOSSIBLE: dict[str, tuple[Any, ...]] = {
    "locked": ("yes", 2), "direction": (0, 2, "left"), "mode": (3, -1, "push", 0.5),
    "knob_range": (-1.0, math.nan, True), "turn_range": (0.0, math.inf, True),
}  # fmt: skip


@pytest.mark.parametrize("mechanism", [CAP, SAFE, MICROWAVE, LAMP])
def test_an_impossible_value_is_refused_with_what_is_allowed(mechanism: Mechanism[Any]) -> None:
    for name in mechanism.hidden_names:
        for value in IMPOSSIBLE[name]:
            with pytest.raises(ConfigurationError, match="allowed:"):
                mechanism.draw(generator(), {name: value})


@pytest.mark.parametrize("mechanism", [CAP, SAFE])
def test_no_range_is_above_the_part_s_own(mechanism: Any) -> None:
    """Where it ends a lock is released: beyond its limit a part could never get there."""
    (name,) = (name for name in mechanism.hidden_names if name.endswith("range"))
    most = mechanism._key_range if mechanism is CAP else mechanism._knob_range
    assert mechanism.hidden(mechanism.draw(generator(), {name: most}))[name] == most
    with pytest.raises(ConfigurationError, match="up to"):
        mechanism.draw(generator(), {name: np.nextafter(most, 9)})


@pytest.mark.parametrize("size", [0.0, -0.01, math.nan, math.inf])
def test_what_cannot_move_is_refused(size: float) -> None:
    builds: tuple[Callable[[float, float], Mechanism[Any]], ...] = (
        SafeMechanism,
        LampMechanism,
        lambda door, button: MicrowaveMechanism(door, button, 0.4),
        lambda key, final: TurnToOpenMechanism("cap", "lift", key_range=key, final_upper=final, success=0.025),
    )
    for build in builds:
        for sizes in ((size, 1.0), (1.0, size)):
            with pytest.raises(ConfigurationError, match="allowed:"):
                build(*sizes)


@every_mechanism
def test_success_is_a_joint_beyond_its_goal_and_nothing_else(mechanism: Mechanism[Any]) -> None:
    assert not mechanism.succeeded(rest(mechanism))
    assert not mechanism.succeeded(dict.fromkeys(mechanism.joints, math.nan))
    for joint in mechanism.joints:
        for share in (-1.01, -0.99, 0.99, 1.01):
            there = rest(mechanism) | {joint: share * mechanism.goals.get(joint, 100.0)}
            assert mechanism.succeeded(there) is (joint in mechanism.goals and abs(share) > 1)


def test_draws_are_as_frequent_as_told_and_independent() -> None:
    hidden = [SAFE.hidden(state) for state in drawn(SAFE, 4000)]
    locked, clockwise = np.array([(each["locked"], each["direction"] == 1) for each in hidden]).T
    shares = np.array([each["knob_range"] for each in hidden]) / 1.5
    assert (locked.mean(), clockwise.mean(), (locked & clockwise).mean()) == pytest.approx((0.5, 0.5, 0.25), abs=0.03)
    assert (shares.min(), shares.mean(), shares.max()) == pytest.approx((0.9, 0.95, 1.0), abs=0.003)
    turns = np.array([state.turn_range for state in drawn(CAP, 4000)]) / 2.35
    assert (turns.min(), turns.mean(), turns.max()) == pytest.approx((0.5, 0.75, 1.0), abs=0.01)
    modes = np.bincount([state.mode for state in drawn(LAMP, 3000)]) / 3000
    assert modes == pytest.approx(np.full(3, 1 / 3), abs=0.03)


@pytest.mark.parametrize(("category", "preset"), [(name, preset) for name in CATEGORIES for preset in rules_of(name)])
def test_an_object_s_mechanism_has_its_joints_and_can_be_solved(category: str, preset: str) -> None:
    obj = make_object(seen_objects(category)[0])
    mechanism = make_mechanism(obj, preset)
    assert set(mechanism.joints) == {link.joint.name for link in obj.links if link.joint and link.joint.name}
    assert set(mechanism.goals) <= set(mechanism.joints)
    assert all(0 < goal < obj.joint(joint).limits[1] for joint, goal in mechanism.goals.items())
    for state in drawn(mechanism, 200):
        for joint, (lower, upper) in mechanism.step(state, rest(mechanism))[1].items():
            assert obj.joint(joint).limits[0] <= lower + 1e-9
            assert upper - 1e-9 <= obj.joint(joint).limits[1]


DIRECTED = [
    name for name in CATEGORIES if "direction" in make_mechanism(make_object(seen_objects(name)[0])).hidden_names
]
FIXED = {"pressure_cooker": 1, "coffee_maker": -1}
"""Direction that neither the paper nor upstream's code draws, though both draw it for the others."""


@pytest.mark.parametrize("preset", ONE_LOCK)
@pytest.mark.parametrize("category", DIRECTED)
def test_a_direction_is_drawn_unless_the_paper_never_tries_one(category: str, preset: str) -> None:
    mechanism = make_mechanism(make_object(seen_objects(category)[0]), preset)
    positive = sum(state.direction == 1 for state in drawn(mechanism, 400)) / 400
    fixed = None if preset == "hard" else FIXED.get(category)
    assert fixed_direction(category, preset) == fixed
    assert positive == (pytest.approx(0.5, abs=0.1) if fixed is None else (fixed == 1))
    assert ("fixed" in mechanism.rules()["draws"]) is (fixed is not None)
    for direction in (-1, 1):
        assert mechanism.draw(generator(), {"direction": direction}).direction == direction


@pytest.mark.parametrize("category", CATEGORIES)
def test_presets_agree_elsewhere_and_draw_all_else_alike(category: str) -> None:
    obj = make_object(seen_objects(category)[0])
    paper, upstream, hard = (make_mechanism(obj, preset) for preset in ONE_LOCK)
    hidden = [
        [mechanism.hidden(state) for state in drawn(mechanism, 32, seed=5)] for mechanism in (paper, upstream, hard)
    ]
    assert hidden[0] == hidden[1]
    assert [{**each, "direction": 0} for each in hidden[0]] == [{**each, "direction": 0} for each in hidden[2]]
    assert (paper.rules() == hard.rules()) is (category not in FIXED)
    assert (paper.rules() == upstream.rules()) is (category != "safe")
