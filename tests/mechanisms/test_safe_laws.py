"""The laws of the safe's mechanism, with ideal joints: a joint goes where it is wished, clipped to its limits."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_joints import DOOR_UPPER, SAFE, TURN_LOCKS, generator, limits_after, play, reading

from lerobot_adamanip.mechanisms import SafeMechanism, replace_rows

angles = st.floats(-3.0, 3.0)
wishes = st.lists(st.fixed_dictionaries({"door": angles, "knob": angles}), max_size=12)
both = pytest.mark.parametrize("mechanism", [SAFE, TURN_LOCKS], ids=["paper", "turn locks"])


def after(mechanism: SafeMechanism, hidden: dict[str, Any], *readings: dict[str, float]) -> float:
    """Returns the door's upper limit after these readings."""
    return limits_after(mechanism, hidden, *readings)["door"][1]


@both
@given(
    pulls=st.lists(st.floats(-10, 10), min_size=1, max_size=8),
    seed=st.integers(0, 2**31 - 1),
    part=st.floats(-0.84, 0.84),
)
@settings(max_examples=50, deadline=None)
def test_a_lock_never_opens_by_force(mechanism: SafeMechanism, pulls: list[float], seed: int, part: float) -> None:
    state = mechanism.draw(1, generator(seed), {"locked": True})
    knob = part * mechanism.hidden(state, 0)["knob_range"]
    for door in pulls:
        state, command = mechanism.step(state, reading({"door": door, "knob": knob}))
        assert (float(command["door"].lower), float(command["door"].upper)) == (0.0, 0.0)


@both
@given(wishes)
@settings(max_examples=40, deadline=None)
def test_a_reading_that_is_no_number_opens_nothing(mechanism: SafeMechanism, sequence: list[dict[str, float]]) -> None:
    readings = [{name: float("nan") for name in wish} for wish in sequence]
    assert after(mechanism, {"locked": True}, *readings) == 0.0


@both
@pytest.mark.parametrize("direction", [-1, 1])
def test_release_is_at_its_fraction_of_the_range_and_one_way(mechanism: SafeMechanism, direction: int) -> None:
    hidden = {"locked": True, "direction": direction, "knob_range": 1.4}
    before, past = {"knob": direction * 1.4 * 0.849}, {"knob": direction * 1.4 * 0.851}
    assert after(mechanism, hidden, before) == 0.0
    assert after(mechanism, hidden, past) == DOOR_UPPER
    assert after(mechanism, hidden, past, {}, {"door": 0.7}, {"door": 0.0}, {}) == DOOR_UPPER


@given(wishes, st.booleans(), st.sampled_from([-1, 1]))
@settings(max_examples=60, deadline=None)
def test_the_door_limit_never_shrinks_in_the_paper_s_safe(
    sequence: list[dict[str, float]], locked: bool, direction: int
) -> None:
    hidden = {"locked": locked, "direction": direction}
    limits = [after(SAFE, hidden, *sequence[:n]) for n in range(len(sequence) + 1)]
    assert limits == sorted(limits)
    assert locked or limits[0] == DOOR_UPPER


def test_the_knob_turns_one_way_only_whatever_happens() -> None:
    seen = play(SAFE, {"direction": -1, "knob_range": 1.4}, [{"door": 0.0, "knob": 3.0}, {"door": 1.0, "knob": -3.0}])
    assert [joints["knob"] for joints in seen] == [0.0, -1.4]


@given(wishes, st.sampled_from([-1, 1]))
@settings(max_examples=60, deadline=None)
def test_locked_and_unlocked_feel_the_same_until_the_door_is_pulled(
    sequence: list[dict[str, float]], direction: int
) -> None:
    not_pulled = [{**wish, "door": -abs(wish["door"])} for wish in sequence]
    pulled = [*[{"door": 0.0, "knob": 0.0}] * len(sequence), {"door": 0.5, "knob": 0.0}]
    locked, unlocked = ({"locked": value, "direction": direction} for value in (True, False))
    assert play(SAFE, locked, not_pulled) == play(SAFE, unlocked, not_pulled)
    assert play(SAFE, locked, pulled)[:-1] == play(SAFE, unlocked, pulled)[:-1]
    assert play(SAFE, locked, pulled)[-1] != play(SAFE, unlocked, pulled)[-1]


@both
@given(wishes, st.booleans())
@settings(max_examples=40, deadline=None)
def test_directions_feel_the_same_until_the_knob_is_turned(
    mechanism: SafeMechanism, sequence: list[dict[str, float]], locked: bool
) -> None:
    not_turned = [{**wish, "knob": 0.0} for wish in sequence]
    one, other = ({"locked": locked, "direction": value} for value in (-1, 1))
    assert play(mechanism, one, not_turned) == play(mechanism, other, not_turned)
    turned = [*not_turned, {"door": 0.0, "knob": 0.3}]
    assert play(mechanism, one, turned)[-1] != play(mechanism, other, turned)[-1]


@given(wishes, st.booleans(), st.sampled_from([-1, 1]))
@settings(max_examples=60, deadline=None)
def test_ranges_feel_the_same_until_the_smaller_one_releases(
    sequence: list[dict[str, float]], locked: bool, direction: int
) -> None:
    gentle = [{**wish, "knob": wish["knob"] / 3.0 * 0.84 * 1.35} for wish in sequence]
    short, long = ({"locked": locked, "direction": direction, "knob_range": value} for value in (1.35, 1.5))
    assert play(SAFE, short, gentle) == play(SAFE, long, gentle)


def test_turning_locks_only_a_shut_door_that_was_not_locked() -> None:
    unlocked = {"locked": False, "direction": 1, "knob_range": 1.4}
    turn, little, full = {"knob": 0.16 * 1.4}, {"knob": 0.14 * 1.4}, {"knob": 1.4}
    assert after(TURN_LOCKS, unlocked, little) == DOOR_UPPER
    assert after(TURN_LOCKS, unlocked, turn) == 0.0
    assert after(TURN_LOCKS, unlocked, turn, full, {}, {"door": 1.0}) == 0.0
    assert after(TURN_LOCKS, unlocked, {"door": 0.3, **turn}, {"door": 0.3}) == DOOR_UPPER
    assert after(TURN_LOCKS, unlocked | {"locked": True}, turn, full) == DOOR_UPPER
    assert after(SAFE, unlocked, full, turn) == DOOR_UPPER


def test_replace_rows_refuses_what_is_no_state() -> None:
    with pytest.raises(TypeError, match="dataclass of tensors"):
        replace_rows([1.0], [2.0], torch.tensor([True]))
