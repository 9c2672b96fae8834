"""Locks in a row, and a lock that shuts again: their laws, and the tries of the best blind strategy by brute force."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_joints import drawn, generator, play, rest

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.tries import MIN_JOINT_MOTION
from lerobot_adamanip.mechanisms import (
    ChangingMechanism,
    Mechanism,
    RowMechanism,
    best_tries,
    categories_with,
    make_mechanism,
)
from lerobot_adamanip.mechanisms.best_tries import SPRUNG
from lerobot_adamanip.mechanisms.composed import PLAY
from lerobot_adamanip.util.errors import ConfigurationError

RULES = ("row", "changing")
CELLS = [(rules, category) for rules in RULES for category in categories_with(rules)]
every_cell = pytest.mark.parametrize(("rules", "category"), CELLS)
Action = tuple[str, int, bool]
"""A joint, the sign of its motion, and whether it goes on beyond rest."""
LET_GO: Action = ("", 0, False)
Place = tuple[float, ...]
INCREMENTS = 12


@dataclass(frozen=True)
class Hidden:
    """A hidden state, by its name and value pairs."""

    values: tuple[tuple[str, Any], ...]

    def as_dict(self) -> dict[str, Any]:
        return dict(self.values)


def mechanism_of(rules: str, category: str) -> Any:
    return make_mechanism(make_object(object_id(category, 0)), rules)


def hidden_states(mechanism: Any) -> Iterator[Hidden]:
    """Every combination of directions and flags; the range is equal in all of them."""
    names = [name for name in mechanism.hidden_names if name != "turn_range"]
    ways = [(-1, 1) if "direction" in name else (False, True) for name in names]
    turn_range = {"turn_range": 0.93 * mechanism._key_range} if "turn_range" in mechanism.hidden_names else {}
    for values in itertools.product(*ways):
        yield Hidden(tuple({**dict(zip(names, values, strict=True)), **turn_range}.items()))


class Episode:
    """One episode on ideal joints: each action moves one joint as far as the limits let it, in small increments."""

    def __init__(self, mechanism: Any, state: Any, joints: dict[str, float]) -> None:
        self.mechanism, self.joints = mechanism, joints
        self.state, self.limits = mechanism.step(state, joints)

    @classmethod
    def of(cls, mechanism: Any, hidden: Hidden) -> Episode:
        return cls(mechanism, mechanism.draw(generator(), hidden.as_dict()), rest(mechanism))

    def copy(self) -> Episode:
        return Episode(self.mechanism, self.state, dict(self.joints))

    def act(self, action: Action) -> float:
        """Moves a joint; returns how far it came in that direction."""
        joint, sign, beyond = action
        springs = self.mechanism.key if action == LET_GO else joint
        start = self.joints[springs]
        reach = 2.0 * max(self.mechanism._key_range, self.mechanism._final_upper)
        goal = 0.0 if action == LET_GO or (not beyond and sign * start < 0) else sign * reach
        for number in range(1, INCREMENTS + 1):
            lower, upper = self.limits[springs]
            wanted = start + (goal - start) * number / INCREMENTS
            self.joints[springs] = min(max(wanted, lower), upper)
            self.state, self.limits = self.mechanism.step(self.state, self.joints)
        return sign * (self.joints[springs] - start)

    @property
    def is_open(self) -> bool:
        return bool(self.mechanism.succeeded(self.joints))


def solve(mechanism: Any, hidden: Hidden) -> int:
    """Returns the number of motions that open a hidden state at least, of key out, key back and pull."""
    actions: list[Action] = [(mechanism.key, 1, True), (mechanism.key, -1, True), (mechanism.final, 1, True)]
    actions += [(mechanism.key, sign, False) for sign in (-1, 1)]
    episodes = [Episode.of(mechanism, hidden)]
    for number in range(1, 9):
        episodes, before = [], episodes
        seen = set()
        for episode, action in itertools.product(before, actions):
            following = episode.copy()
            following.act(action)
            if following.is_open:
                return number
            key = (following.state, tuple(following.joints.values()))
            if key not in seen:
                seen.add(key)
                episodes.append(following)
    raise AssertionError(f"{hidden} cannot be opened")


@every_cell
def test_every_hidden_state_can_be_opened_and_needs_two_motions_at_least(rules: str, category: str) -> None:
    mechanism = mechanism_of(rules, category)
    lengths = {hidden: solve(mechanism, hidden) for hidden in hidden_states(mechanism)}
    assert min(lengths.values()) == 2, "a key and a pull"
    if rules == "row":
        for hidden, length in lengths.items():
            second, third = hidden.as_dict()["second_pulls"], hidden.as_dict()["third_pulls"]
            assert length == 4 - third - (second and third), "each lock that a pull frees saves the key's motion"
    else:
        assert {hidden.as_dict()["relocks"] for hidden, length in lengths.items() if length > 2} == {True}


@pytest.mark.parametrize("category", categories_with("row"))
def test_in_a_row_only_the_next_motion_is_free(category: str) -> None:
    """Order matters: in each state of the row one joint is blocked, and which of them is hidden."""
    mechanism = mechanism_of("row", category)
    key, pull = mechanism.key, (mechanism.final, 1, True)
    for hidden in hidden_states(mechanism):
        values = hidden.as_dict()
        out, back = (key, values["direction"], True), (key, -values["direction"], False)
        episode = Episode.of(mechanism, hidden)
        assert episode.copy().act(pull) == 0.0
        assert episode.copy().act((key, -values["direction"], True)) == 0.0
        assert episode.act(out) > 0
        pulls, moves = (values["second_pulls"], values["third_pulls"]), {True: pull, False: back}
        for number, is_pull in enumerate(pulls):
            if number and pulls[0] and is_pull:
                continue  # the first pull has gone on to the end
            moves[False] = back if abs(episode.joints[key]) > 1e-6 else out
            assert abs(episode.copy().act(moves[not is_pull])) < 1e-9, (values, number, "the other motion is blocked")
            assert abs(episode.act(moves[is_pull])) > 1e-3
        episode.act(pull)
        assert episode.is_open


@pytest.mark.parametrize("category", categories_with("changing"))
def test_a_lock_shuts_again_at_its_first_pull_and_once(category: str) -> None:
    mechanism = mechanism_of("changing", category)
    kind = make_object(object_id(category, 0)).joint(mechanism.final).kind
    key, pull = mechanism.key, (mechanism.final, 1, True)
    for hidden in hidden_states(mechanism):
        values = hidden.as_dict()
        episode = Episode.of(mechanism, hidden)
        first, later = values.get("direction", 1), values.get("later_direction", 1)
        episode.act((key, first, True))
        moved = episode.act(pull)
        if not values["relocks"]:
            assert episode.is_open
            continue
        assert moved == pytest.approx(PLAY[kind])
        assert moved < MIN_JOINT_MOTION[kind], "it counts as a failed try"
        assert episode.act(pull) < PLAY[kind], "shut"
        episode.act((key, first, True))
        assert episode.act(pull) < PLAY[kind], "a key that is still turned does not count"
        episode.act((key, -first, later != first))
        episode.act((key, later, True))
        assert episode.act(pull) > 0
        assert episode.is_open


@every_cell
@given(st.integers(0, 10**6), st.lists(st.tuples(st.booleans(), st.floats(-2.5, 2.5)), max_size=12))
@settings(max_examples=40, deadline=None)
def test_limits_hold_each_joint_where_it_may_be(
    rules: str, category: str, seed: int, wishes: list[tuple[bool, float]]
) -> None:
    """No limit ever pushes a joint, and a step is pure."""
    mechanism = mechanism_of(rules, category)
    state, joints = drawn(mechanism, 1, seed)[0], rest(mechanism)
    hidden = mechanism.hidden(state)
    for is_key, wish in wishes:
        following, limits = mechanism.step(state, joints)
        assert (following, limits) == mechanism.step(state, dict(joints))
        for name, (lower, upper) in limits.items():
            assert lower - 1e-12 <= joints[name] <= upper + 1e-12, (name, joints, limits)
        name = mechanism.key if is_key else mechanism.final
        joints[name] = min(max(wish * abs(joints[name] or 1.0), limits[name][0]), limits[name][1])
        state = following
    assert mechanism.hidden(state) == hidden


@every_cell
def test_hidden_states_feel_the_same_until_a_motion_tells(rules: str, category: str) -> None:
    mechanism = mechanism_of(rules, category)
    pull = {mechanism.final: 1.0}
    first = [play(mechanism, hidden.as_dict(), [pull, {}, pull]) for hidden in hidden_states(mechanism)]
    assert all(each == first[0] for each in first), "a pull at the start tells nothing"


@every_cell
def test_draws_are_reproducible_and_a_fixed_value_changes_no_other(rules: str, category: str) -> None:
    mechanism = mechanism_of(rules, category)
    for seed in range(8):
        state = mechanism.draw(generator(seed))
        assert mechanism.draw(generator(seed + 1), mechanism.hidden(state)) == state
        for name in mechanism.hidden_names:
            value = {"turn_range": 0.7}.get(name, 1 if "direction" in name else True)
            other = mechanism.draw(generator(seed), {name: value})
            assert mechanism.hidden(other) == mechanism.hidden(state) | {name: value}
    flags = [name for name in mechanism.hidden_names if name != "turn_range"]
    hidden = [mechanism.hidden(state) for state in drawn(mechanism, 600)]
    for name in flags:
        assert sum(each[name] > 0 for each in hidden) / 600 == pytest.approx(0.5, abs=0.07)


# The best blind strategy -----------------------------------------------------------------------------------------


def best_by_force(mechanism: Any, kind: str, *, is_sprung: bool) -> tuple[float, int]:
    """Returns the failed tries of the best strategy that does not know the hidden state: expected, and at worst.

    It may push each joint either way, to its stop or to rest, and let a sprung key go. A push fails if the joint does
    not move, unless it goes on from one that has moved it: that is one try, see `episode.tries`.
    """
    key, final = mechanism.key, mechanism.final
    actions: list[Action] = [(final, 1, True), *((key, sign, beyond) for sign in (-1, 1) for beyond in (True, False))]
    actions += [LET_GO] if is_sprung else []
    least = {final: MIN_JOINT_MOTION[kind], key: 1e-4}

    @cache
    def after(state: Any, place: Place, action: Action) -> tuple[Any, Place]:
        episode = Episode(mechanism, state, dict(zip(mechanism.joints, place, strict=True)))
        episode.act(action)
        return episode.state, tuple(round(each, 9) for each in episode.joints.values())

    @cache
    def cost(belief: frozenset[Any], place: Place, latest: tuple[str, int], left: int) -> tuple[float, float]:
        best = (math.inf, math.inf)
        for action in actions if left else ():
            groups: dict[Place, set[Any]] = {}
            for state in belief:
                following, there = after(state, place, action)
                groups.setdefault(there, set()).add(following)
            if set(groups) == {place} and action[:2] in (latest, LET_GO[:2]):
                continue  # it changes nothing and tells nothing
            expected, worst = 0.0, 0.0
            for there, group in groups.items():
                failed = fails(action, place, there, latest)
                is_open = mechanism.succeeded(dict(zip(mechanism.joints, there, strict=True)))
                more = (0.0, 0.0) if is_open else cost(frozenset(group), there, action[:2], left - 1)
                expected += len(group) / len(belief) * (failed + more[0])
                worst = max(worst, failed + more[1])
            best = min(best[0], expected), min(best[1], worst)
        return best

    def fails(action: Action, place: Place, there: Place, latest: tuple[str, int]) -> int:
        if action == LET_GO or action[:2] == latest:
            return 0
        index = mechanism.joints.index(action[0])
        return int(abs(there[index] - place[index]) <= least[action[0]])

    states = frozenset(Episode.of(mechanism, hidden).state for hidden in hidden_states(mechanism))
    expected, worst = cost(states, (0.0, 0.0), ("none", 0), 8 if is_sprung else 7)
    return expected, int(worst)


@pytest.mark.parametrize(
    ("rules", "category"), [("row", "bottle"), ("row", "door"), ("changing", "bottle"), ("changing", "microwave")]
)
def test_the_best_strategy_needs_the_tries_of_the_table(rules: str, category: str) -> None:
    obj = make_object(object_id(category, 0))
    mechanism: Any = make_mechanism(obj, rules)
    is_sprung = obj.joint(mechanism.key).stiffness > 0
    found = best_by_force(mechanism, obj.joint(mechanism.final).kind, is_sprung=is_sprung)
    assert found == best_tries(category, rules, mechanism.hidden_names)


@pytest.mark.parametrize("category", categories_with("row"))
def test_a_row_costs_two_failed_tries_at_worst_and_springs_are_known(category: str) -> None:
    mechanism = mechanism_of("row", category)
    worst = best_tries(category, "row", mechanism.hidden_names)[1]
    is_sprung = make_object(object_id(category, 0)).joint(mechanism.key).stiffness > 0
    assert worst == 2
    assert (category in SPRUNG) is is_sprung


def test_a_category_without_the_rules_is_refused_with_those_that_have_them() -> None:
    for rules, missing in (("row", {"lamp", "microwave"}), ("changing", {"lamp"})):
        assert set(CATEGORIES) - set(categories_with(rules)) == missing
        for category in missing:
            with pytest.raises(ConfigurationError) as caught:
                EnvironmentOptions(category=category, mechanism_rules=rules)
            assert all(name in str(caught.value) for name in (category, *categories_with(rules)))
            assert f"--env.type=adamanip_{categories_with(rules)[0]}" in str(caught.value)


def test_a_button_that_stays_in_has_no_lock_that_shuts_again() -> None:
    microwave = make_object(object_id("microwave", 0))
    links = tuple(
        replace(link, joint=replace(link.joint, stiffness=0.0)) if link.joint and link.joint.name == "button" else link
        for link in microwave.links
    )
    with pytest.raises(ConfigurationError, match="cannot be pushed again"):
        make_mechanism(replace(microwave, links=links), "changing")


@pytest.mark.parametrize("kind", [RowMechanism, ChangingMechanism])
def test_what_cannot_move_is_refused(kind: type[Mechanism[Any]]) -> None:
    more: dict[str, Any] = {"notch": 0.1} if kind is RowMechanism else {"release": 0.85, "play": 0.01}
    for sizes in ((0.0, 1.0), (1.0, math.nan)):
        with pytest.raises(ConfigurationError, match="allowed:"):
            kind("key", "final", key_range=sizes[0], final_upper=sizes[1], fractions=(0.5, 1.0), success=0.4, **more)
