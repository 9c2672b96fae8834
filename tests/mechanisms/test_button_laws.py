"""The laws of microwave and lamp: a button that frees a door, and a part that is pushed or turned."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_joints import DOOR_UPPER, LAMP, MICROWAVE, generator, limits_after, play, reading

from lerobot_adamanip.mechanisms import LampMechanism, MicrowaveMechanism, MicrowaveMechanismConfig
from lerobot_adamanip.util.errors import ConfigurationError

some = settings(max_examples=40, deadline=None)
TRAVEL = 0.013
wishes = st.lists(
    st.fixed_dictionaries({"door": st.floats(-3, 3), "button": st.floats(-0.05, 0.05)}), min_size=1, max_size=10
)
LOCKED, UNLOCKED = {"locked": True}, {"locked": False}
OPENED = (0.0, DOOR_UPPER)


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=8), st.floats(-2, 0.69))
@some
def test_a_locked_microwave_never_opens_by_force(pulls: list[float], part: float) -> None:
    for number in range(1, len(pulls) + 1):
        readings = [{"door": pull, "button": max(part, -0.69) * TRAVEL} for pull in pulls[:number]]
        assert limits_after(MICROWAVE, LOCKED, *readings)["door"] == (0.0, 0.0)


@given(st.integers(1, 5))
@some
def test_a_reading_that_is_no_number_opens_nothing(count: int) -> None:
    readings = [{"door": math.nan, "button": math.nan}] * count
    assert limits_after(MICROWAVE, LOCKED, *readings)["door"] == (0.0, 0.0)


def test_the_button_frees_the_door_at_its_fraction_and_for_good() -> None:
    before, past = ({"button": share * TRAVEL} for share in (0.69, 0.71))
    assert limits_after(MICROWAVE, LOCKED, before)["door"] == (0.0, 0.0)
    assert limits_after(MICROWAVE, LOCKED, past)["door"] == OPENED
    assert limits_after(MICROWAVE, LOCKED, past, {}, {"door": 0.7}, {"door": 0.0}, before)["door"] == OPENED


@given(wishes, st.booleans())
@some
def test_the_door_s_limit_never_shrinks_and_the_button_always_moves(
    sequence: list[dict[str, float]], locked: bool
) -> None:
    limits = [limits_after(MICROWAVE, {"locked": locked}, *sequence[:n]) for n in range(len(sequence) + 1)]
    doors = [each["door"] for each in limits]
    assert doors == sorted(doors)
    assert doors[0] == ((0.0, 0.0) if locked else OPENED)
    assert {each["button"] for each in limits} == {(0.0, TRAVEL)}, "it tells nothing about the lock"


@given(wishes)
@some
def test_locked_and_unlocked_feel_the_same_until_the_door_is_pulled(sequence: list[dict[str, float]]) -> None:
    not_pulled = [{**wish, "door": -abs(wish["door"])} for wish in sequence]
    assert play(MICROWAVE, LOCKED, not_pulled) == play(MICROWAVE, UNLOCKED, not_pulled)
    pulled = [{"button": 0.5 * TRAVEL}, {"door": 0.5}]
    locked, unlocked = (play(MICROWAVE, hidden, pulled) for hidden in (LOCKED, UNLOCKED))
    assert locked[0] == unlocked[0]
    assert locked[1] != unlocked[1]
    assert not any(MICROWAVE.succeeded(reading(joints)).item() for joints in (locked[0], unlocked[0]))


def test_pushing_the_button_spoils_nothing_that_was_open() -> None:
    for share in (0.1, 0.5, 1.0):
        assert limits_after(MICROWAVE, UNLOCKED, {"button": share * TRAVEL}, {})["door"] == OPENED


@given(st.booleans())
@some
def test_push_and_pull_is_success_and_pushing_alone_is_not(locked: bool) -> None:
    hidden = {"locked": locked}
    pushed, pulled = {"button": 1.0}, {"door": 1.0}
    assert not MICROWAVE.succeeded(reading(play(MICROWAVE, hidden, [pushed])[-1])).item()
    assert MICROWAVE.succeeded(reading(play(MICROWAVE, hidden, [pushed, pulled])[-1])).item()
    assert MICROWAVE.succeeded(reading(play(MICROWAVE, hidden, [pulled])[-1])).item() is not locked


def test_how_often_it_is_locked_is_configured_and_told() -> None:
    config = MicrowaveMechanismConfig(p_locked=0.3, release_fraction=0.4)
    mechanism = MicrowaveMechanism(DOOR_UPPER, TRAVEL, math.pi / 7, config)
    state = mechanism.draw(4000, generator())
    assert sum(mechanism.hidden(state, i)["locked"] for i in range(4000)) / 4000 == pytest.approx(0.3, abs=0.03)
    assert all(number in " ".join(mechanism.rules().values()) for number in ("0.3", "0.4"))
    assert limits_after(mechanism, LOCKED, {"button": 0.41 * TRAVEL})["door"] == OPENED


FREE = {0: ("button", (0.0, 0.022)), 1: ("knob", (0.0, 1.4)), 2: ("knob", (-1.4, 0.0))}
lamp_wishes = st.lists(st.fixed_dictionaries({"button": st.floats(-0.1, 0.1), "knob": st.floats(-3, 3)}), max_size=10)
modes = st.sampled_from([0, 1, 2])


@given(lamp_wishes, modes)
@some
def test_one_motion_is_free_and_the_others_blocked_whatever_happens(
    sequence: list[dict[str, float]], mode: int
) -> None:
    joint, limits = FREE[mode]
    for number in range(len(sequence) + 1):
        found = limits_after(LAMP, {"mode": mode}, *sequence[:number])
        assert found == {"button": (0.0, 0.0), "knob": (0.0, 0.0)} | {joint: limits}


@given(lamp_wishes, modes, modes)
@some
def test_modes_feel_the_same_until_one_is_tried_that_is_free(
    sequence: list[dict[str, float]], one: int, other: int
) -> None:
    third = ({0, 1, 2} - {one, other}).pop()
    joint, (lower, _) = FREE[third]
    tried = [{joint: -abs(wish[joint]) if lower < 0 else abs(wish[joint])} for wish in sequence]
    seen = [play(LAMP, {"mode": mode}, tried) for mode in (one, other)]
    assert seen[0] == seen[1]
    assert all(not LAMP.succeeded(reading(joints)).item() for joints in seen[0])
    for mode in {one, other}:
        name, (low, high) = FREE[mode]
        assert LAMP.succeeded(reading(play(LAMP, {"mode": mode}, [*tried, {name: low + high}])[-1])).item()


def test_each_mode_comes_a_third_of_the_time() -> None:
    state = LAMP.draw(3000, generator())
    drawn = [LAMP.hidden(state, i)["mode"] for i in range(3000)]
    for mode in (0, 1, 2):
        assert drawn.count(mode) / 3000 == pytest.approx(1 / 3, abs=0.03)


@pytest.mark.parametrize("overrides", [{"mode": 3}, {"mode": -1}, {"mode": "push"}, {"mode": 0.5}, {"locked": True}])
def test_an_impossible_mode_is_refused(overrides: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="allowed:"):
        LAMP.draw(1, generator(), overrides)


@pytest.mark.parametrize("overrides", [{"locked": 2}, {"locked": "no"}, {"direction": 1}, {"button": 0.01}])
def test_an_impossible_lock_is_refused(overrides: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="allowed:"):
        MICROWAVE.draw(1, generator(), overrides)


@pytest.mark.parametrize("size", [0.0, -0.01, math.nan, math.inf])
def test_what_cannot_move_is_refused(size: float) -> None:
    for build in (
        lambda: LampMechanism(size, 1.4),
        lambda: LampMechanism(0.02, size),
        lambda: MicrowaveMechanism(size, 0.01, 0.4),
        lambda: MicrowaveMechanism(1.5, size, 0.4),
    ):
        with pytest.raises(ConfigurationError, match="allowed:"):
            build()
