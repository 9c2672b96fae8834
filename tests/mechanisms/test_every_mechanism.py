"""What every mechanism is: pure, batched, reproducible, and told in words."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_joints import MECHANISMS, generator, leaves, random_reading, reading, rest, same, take

from lerobot_adamanip.catalog import make_object, seen_objects
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.mechanisms import (
    DEFAULT_MECHANISM_RULES,
    MECHANISM_RULES,
    RULES,
    Mechanism,
    fixed_direction,
    make_mechanism,
    replace_rows,
)
from lerobot_adamanip.mechanisms.arrays import as_arrays
from lerobot_adamanip.util.errors import ConfigurationError

every_mechanism = pytest.mark.parametrize("mechanism", MECHANISMS.values(), ids=MECHANISMS)
some = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 1000)


@every_mechanism
@given(st.permutations(range(6)), seeds)
@some
def test_batch_order_does_not_matter(mechanism: Mechanism[Any], order: list[int], seed: int) -> None:
    rows = torch.tensor(order)
    state = mechanism.draw(6, generator(seed))
    shuffled = take(state, rows)
    for t in range(4):
        joints = random_reading(mechanism, 6, seed + 10 * t)
        state, command = mechanism.step(state, joints)
        shuffled, shuffled_command = mechanism.step(shuffled, {name: q[rows] for name, q in joints.items()})
        assert same(take(state, rows), shuffled)
        assert all(same(take(command[name], rows), shuffled_command[name]) for name in mechanism.joints)


@every_mechanism
@given(st.integers(0, 5), seeds)
@some
def test_an_environment_goes_on_alone_as_it_would_among_others(mechanism: Mechanism[Any], row: int, seed: int) -> None:
    only = torch.tensor([row])
    state = mechanism.draw(6, generator(seed))
    alone = take(state, only)
    for t in range(4):
        joints = random_reading(mechanism, 6, seed + 10 * t)
        state, command = mechanism.step(state, joints)
        alone, command_alone = mechanism.step(alone, {name: q[only] for name, q in joints.items()})
        assert same(take(state, only), alone)
        assert all(same(take(command[name], only), command_alone[name]) for name in mechanism.joints)


@every_mechanism
@given(st.lists(st.booleans(), min_size=6, max_size=6), seeds)
@some
def test_resetting_some_environments_leaves_the_others_bit_identical(
    mechanism: Mechanism[Any], resets: list[bool], seed: int
) -> None:
    mask = torch.tensor(resets)
    state = mechanism.draw(6, generator(seed))
    state, _ = mechanism.step(state, random_reading(mechanism, 6, seed))
    fresh = mechanism.draw(6, generator(seed + 1))
    mixed = replace_rows(state, fresh, mask)
    assert same(take(mixed, ~mask), take(state, ~mask))
    assert same(take(mixed, mask), take(fresh, mask))
    joints = random_reading(mechanism, 6, seed + 5)
    assert same(take(mechanism.step(mixed, joints)[0], ~mask), take(mechanism.step(state, joints)[0], ~mask))


@every_mechanism
def test_step_changes_none_of_its_arguments_and_is_repeatable(mechanism: Mechanism[Any]) -> None:
    state, joints = mechanism.draw(8, generator()), random_reading(mechanism, 8, 3)
    state_before, joints_before = copy.deepcopy(state), copy.deepcopy(joints)
    first, random_state = mechanism.step(state, joints), torch.get_rng_state()
    second = mechanism.step(state, joints)
    assert same(state, state_before)
    assert all(torch.equal(joints[name], joints_before[name]) for name in joints)
    assert same(first[0], second[0])
    assert torch.equal(random_state, torch.get_rng_state())


@every_mechanism
def test_numpy_numbers_obey_the_same_rules_as_tensors(mechanism: Mechanism[Any]) -> None:
    state = mechanism.draw(32, generator())
    arrays = as_arrays(state)
    for t in range(6):
        joints = random_reading(mechanism, 32, t)
        numbers: Any = {name: q.numpy() for name, q in joints.items()}
        state, command = mechanism.step(state, joints)
        arrays, commanded = mechanism.step(arrays, numbers)
        assert all(np.array_equal(a.numpy(), b) for a, b in zip(leaves(state), leaves(arrays), strict=True))
        for name, limits in command.items():
            assert np.array_equal(limits.lower.numpy(), commanded[name].lower)
            assert np.array_equal(limits.upper.numpy(), commanded[name].upper)
        assert np.array_equal(mechanism.succeeded(joints).numpy(), mechanism.succeeded(numbers))
        assert mechanism.hidden(state, 3) == mechanism.hidden(arrays, 3)


@every_mechanism
def test_it_commands_each_of_its_joints_and_zero_is_always_allowed(mechanism: Mechanism[Any]) -> None:
    state = mechanism.draw(32, generator())
    for t in range(6):
        state, command = mechanism.step(state, random_reading(mechanism, 32, t))
        assert set(command) == set(mechanism.joints)
        for limits in command.values():
            assert limits.lower.shape == limits.upper.shape == (32,)
            assert torch.all((limits.lower <= 0) & (limits.upper >= 0)), "at rest no joint is pushed anywhere"


@every_mechanism
def test_hidden_values_stay_as_drawn_while_it_is_worked(mechanism: Mechanism[Any]) -> None:
    state = mechanism.draw(4, generator())
    before = [mechanism.hidden(state, i) for i in range(4)]
    for t in range(5):
        state, _ = mechanism.step(state, random_reading(mechanism, 4, t))
    assert [mechanism.hidden(state, i) for i in range(4)] == before


@every_mechanism
@given(st.integers(0, 2**31 - 2))
@some
def test_equal_seeds_give_equal_draws_and_hidden_values_reproduce_an_episode(
    mechanism: Mechanism[Any], seed: int
) -> None:
    state = mechanism.draw(3, generator(seed))
    assert same(state, mechanism.draw(3, generator(seed)))
    hidden = json.loads(json.dumps(mechanism.hidden(state, 1)))
    again = mechanism.draw(1, generator(seed + 1), hidden)
    assert mechanism.hidden(again, 0) == hidden
    assert same(again, take(state, torch.tensor([1]))), "nothing is hidden beside what is told"


@every_mechanism
def test_a_value_fixed_by_name_changes_no_other(mechanism: Mechanism[Any]) -> None:
    values = {"locked": True, "direction": -1, "turn_range": 0.9, "knob_range": 1.3, "mode": 2}
    for name in mechanism.hidden(mechanism.draw(1, generator()), 0):
        free, fixed = generator(7), generator(7)
        drawn, forced = mechanism.draw(16, free), mechanism.draw(16, fixed, {name: values[name]})
        for i in range(16):
            assert mechanism.hidden(forced, i) == mechanism.hidden(drawn, i) | {name: values[name]}
        assert torch.equal(free.get_state(), fixed.get_state())
        assert [leaf.dtype for leaf in leaves(forced)] == [leaf.dtype for leaf in leaves(drawn)]


@every_mechanism
def test_a_name_it_does_not_have_is_refused_with_those_it_has(mechanism: Mechanism[Any]) -> None:
    for wrong in ({"lokced": True}, {"colour": 1}):
        with pytest.raises(ConfigurationError) as caught:
            mechanism.draw(1, generator(), wrong)
        hidden = mechanism.hidden(mechanism.draw(1, generator()), 0)
        assert all(name in str(caught.value) for name in (*hidden, *wrong))


@every_mechanism
def test_draws_use_no_random_source_but_the_given_one(mechanism: Mechanism[Any]) -> None:
    before = torch.get_rng_state()
    first = mechanism.draw(9, generator(3))
    torch.manual_seed(99)
    assert same(mechanism.draw(9, generator(3)), first)
    torch.set_rng_state(before)
    mechanism.draw(9, generator(3))
    assert torch.equal(torch.get_rng_state(), before)


@every_mechanism
def test_success_is_a_joint_beyond_its_goal_and_nothing_else(mechanism: Mechanism[Any]) -> None:
    assert set(mechanism.goals) <= set(mechanism.joints)
    assert not mechanism.succeeded(reading(rest(mechanism))).any()
    for joint in mechanism.joints:
        for sign in (-1, 1):
            for far in (0.99, 1.01):
                position = sign * far * mechanism.goals.get(joint, 100.0)
                expected = joint in mechanism.goals and far > 1
                assert mechanism.succeeded(reading(rest(mechanism) | {joint: position})).item() is expected
    nowhere = mechanism.succeeded(reading(dict.fromkeys(mechanism.joints, math.nan), 3))
    assert nowhere.tolist() == [False] * 3


@every_mechanism
def test_success_is_told_for_each_environment_apart(mechanism: Mechanism[Any]) -> None:
    joint, goal = next(iter(mechanism.goals.items()))
    joints = reading(rest(mechanism), 4)
    joints[joint] = torch.tensor([0.0, 2 * goal, 0.5 * goal, 3 * goal], dtype=torch.float64)
    assert mechanism.succeeded(joints).tolist() == [False, True, False, True]


@every_mechanism
def test_its_rules_are_told_in_words(mechanism: Mechanism[Any]) -> None:
    rules = mechanism.rules()
    assert set(rules) == {"hidden", "draws", "thresholds"}
    assert all(words == words.strip() and len(words) > 5 for words in rules.values())


@pytest.mark.parametrize("preset", MECHANISM_RULES)
@pytest.mark.parametrize("category", CATEGORIES)
def test_an_object_s_mechanism_has_its_joints_and_can_be_solved(category: str, preset: str) -> None:
    obj = make_object(seen_objects(category)[0])
    mechanism = make_mechanism(obj, preset)
    assert set(mechanism.joints) == {link.joint.name for link in obj.links if link.joint and link.joint.name}
    for joint, goal in mechanism.goals.items():
        assert 0 < goal < obj.joint(joint).limits[1]
    state = mechanism.draw(200, generator())
    state, command = mechanism.step(state, reading(rest(mechanism), 200))
    for joint in mechanism.joints:
        lower, upper = obj.joint(joint).limits
        assert torch.all((command[joint].lower >= lower - 1e-9) & (command[joint].upper <= upper + 1e-9))


def test_an_unknown_preset_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)paper.*upstream"):
        make_mechanism(make_object("lamp_000"), "author")


FIXED = {"pressure_cooker": 1, "coffee_maker": -1}
"""Direction that neither the paper nor upstream's code draws, though both draw it for the others."""


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("preset", MECHANISM_RULES)
@pytest.mark.parametrize("category", [name for name in CATEGORIES if name not in ("microwave", "lamp")])
def test_a_direction_is_drawn_unless_the_paper_never_tries_one(category: str, preset: str, seed: int) -> None:
    mechanism = make_mechanism(make_object(seen_objects(category)[0]), preset)
    state = mechanism.draw(400, generator(seed))
    positive = sum(mechanism.hidden(state, i)["direction"] == 1 for i in range(400)) / 400
    if preset != "hard" and category in FIXED:
        assert positive == (FIXED[category] == 1)
        assert "fixed" in mechanism.rules()["draws"]
        assert fixed_direction(category, preset) == FIXED[category]
    else:
        assert positive == pytest.approx(0.5, abs=0.1)
        assert fixed_direction(category, preset) is None


@pytest.mark.parametrize("category", FIXED)
def test_a_fixed_direction_can_still_be_overridden(category: str) -> None:
    mechanism = make_mechanism(make_object(seen_objects(category)[0]), "paper")
    for direction in (-1, 1):
        state = mechanism.draw(8, generator(), {"direction": direction})
        assert {mechanism.hidden(state, i)["direction"] for i in range(8)} == {direction}


def test_upstream_s_safe_is_locked_by_turning_and_no_other() -> None:
    obj = make_object(seen_objects("safe")[0])
    shut = {}
    for preset in MECHANISM_RULES:
        mechanism = make_mechanism(obj, preset)
        state = mechanism.draw(1, generator(), {"locked": False, "direction": 1})
        for knob in (0.0, 0.3):
            state, command = mechanism.step(state, reading({"door": 0.0, "knob": knob}))
        shut[preset] = float(command["door"].upper) == 0.0
        assert ("locks it" in mechanism.rules()["thresholds"]) is shut[preset]
    assert shut == {"paper": False, "upstream": True, "hard": False}


@pytest.mark.parametrize("seed", [5, 6])
@pytest.mark.parametrize("category", CATEGORIES)
def test_presets_agree_elsewhere_and_draw_all_else_alike(category: str, seed: int) -> None:
    obj = make_object(seen_objects(category)[0])
    paper, upstream, hard = (make_mechanism(obj, preset) for preset in MECHANISM_RULES)
    one, other = paper.draw(32, generator(seed)), hard.draw(32, generator(seed))
    if category not in FIXED:
        assert paper.rules() == hard.rules()
        assert same(one, other)
    for i in range(32):
        first, second = paper.hidden(one, i), hard.hidden(other, i)
        assert {**first, "direction": 0} == {**second, "direction": 0}, "a preset changes no other draw"
    if category != "safe":
        assert paper.rules() == upstream.rules()
        assert same(one, upstream.draw(32, generator(seed)))


def test_the_table_of_rules_has_a_row_of_every_category_and_says_where_it_is_from() -> None:
    assert tuple(RULES) == tuple(CATEGORIES)
    assert DEFAULT_MECHANISM_RULES in MECHANISM_RULES
    for rules in RULES.values():
        assert any(place in rules.paper for place in ("(3.2)", "(figure 2)", "(appendix)"))
        assert rules.reading
        assert rules.fixed_direction in (None, -1, 1)
