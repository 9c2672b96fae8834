"""The laws of what is turned and then opened: it turns one way, opens by turning alone, and shows neither."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_joints import CAP, LEVER, generator, limits_after, play, reading

from lerobot_adamanip.mechanisms import TurnToOpenMechanism, TurnToOpenMechanismConfig
from lerobot_adamanip.util.errors import ConfigurationError

both = pytest.mark.parametrize("mechanism", [CAP, LEVER], ids=["cap", "lever"])
some = settings(max_examples=40, deadline=None)
NOMINAL, UPPER = {"cap": 2.35, "lever": 1.05}, {"cap": 0.05, "lever": 1.57}
directions, fractions = st.sampled_from([-1, 1]), st.floats(0.5, 1.0)
wishes = st.lists(st.tuples(st.floats(-3, 3), st.floats(-2, 2)), max_size=10)


def hidden(mechanism: TurnToOpenMechanism, direction: int, fraction: float) -> dict[str, Any]:
    return {"direction": direction, "turn_range": fraction * NOMINAL[mechanism.key]}


def named(mechanism: TurnToOpenMechanism, pairs: list[tuple[float, float]]) -> list[dict[str, float]]:
    return [{mechanism.key: key, mechanism.final: final} for key, final in pairs]


@both
@given(st.lists(st.floats(-10, 10), min_size=1, max_size=8), st.floats(-0.84, 0.84), directions, fractions)
@some
def test_it_never_opens_by_force(
    mechanism: TurnToOpenMechanism, pulls: list[float], part: float, direction: int, fraction: float
) -> None:
    draw = hidden(mechanism, direction, fraction)
    for number in range(1, len(pulls) + 1):
        readings = named(mechanism, [(part * draw["turn_range"], pull) for pull in pulls[:number]])
        assert limits_after(mechanism, draw, *readings)[mechanism.final] == (0.0, 0.0)


@both
@given(st.integers(1, 5), directions)
@some
def test_a_reading_that_is_no_number_opens_nothing(mechanism: TurnToOpenMechanism, count: int, direction: int) -> None:
    readings = named(mechanism, [(math.nan, math.nan)] * count)
    assert limits_after(mechanism, hidden(mechanism, direction, 0.7), *readings)[mechanism.final] == (0.0, 0.0)


@both
@given(directions, fractions)
@some
def test_it_is_free_from_its_fraction_of_the_range_on_for_good(
    mechanism: TurnToOpenMechanism, direction: int, fraction: float
) -> None:
    draw = hidden(mechanism, direction, fraction)
    before, past = ({mechanism.key: direction * share * draw["turn_range"]} for share in (0.849, 0.851))
    opened = (0.0, UPPER[mechanism.key])
    assert limits_after(mechanism, draw, before)[mechanism.final] == (0.0, 0.0)
    assert limits_after(mechanism, draw, past)[mechanism.final] == opened
    halfway = {mechanism.final: 0.5 * UPPER[mechanism.key]}
    assert limits_after(mechanism, draw, past, {}, halfway, before, {})[mechanism.final] == opened


@both
@given(wishes, directions, fractions)
@some
def test_it_turns_one_way_only_as_far_as_was_drawn(
    mechanism: TurnToOpenMechanism, pairs: list[tuple[float, float]], direction: int, fraction: float
) -> None:
    draw = hidden(mechanism, direction, fraction)
    expected = (0.0, draw["turn_range"]) if direction > 0 else (-draw["turn_range"], 0.0)
    for number in range(len(pairs) + 1):
        assert limits_after(mechanism, draw, *named(mechanism, pairs[:number]))[mechanism.key] == expected
    for joints in play(mechanism, draw, named(mechanism, pairs)):
        assert 0 <= direction * joints[mechanism.key] <= draw["turn_range"]
        assert 0 <= joints[mechanism.final] <= UPPER[mechanism.key]


@both
@given(wishes, directions, fractions)
@some
def test_the_limit_of_what_opens_never_shrinks(
    mechanism: TurnToOpenMechanism, pairs: list[tuple[float, float]], direction: int, fraction: float
) -> None:
    draw, readings = hidden(mechanism, direction, fraction), named(mechanism, pairs)
    limits = [limits_after(mechanism, draw, *readings[:n])[mechanism.final] for n in range(len(readings) + 1)]
    assert limits == sorted(limits)
    assert limits[0] == (0.0, 0.0), "every one is shut at first"


@both
@given(wishes, fractions)
@some
def test_directions_feel_the_same_until_it_is_turned(
    mechanism: TurnToOpenMechanism, pairs: list[tuple[float, float]], fraction: float
) -> None:
    one, other = (hidden(mechanism, direction, fraction) for direction in (-1, 1))
    not_turned = [{mechanism.final: final} for _, final in pairs]
    assert play(mechanism, one, not_turned) == play(mechanism, other, not_turned)
    turned = [*not_turned, {mechanism.key: 0.2}]
    assert play(mechanism, one, turned)[-1] != play(mechanism, other, turned)[-1]
    assert play(mechanism, one, turned)[:-1] == play(mechanism, other, turned)[:-1]


@both
@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-2, 2)), max_size=10), directions)
@some
def test_ranges_feel_the_same_until_the_shortest_releases(
    mechanism: TurnToOpenMechanism, pairs: list[tuple[float, float]], direction: int
) -> None:
    short, long = (hidden(mechanism, direction, fraction) for fraction in (0.6, 0.9))
    gentle = named(mechanism, [(0.84 * short["turn_range"] * share, final) for share, final in pairs])
    assert play(mechanism, short, gentle) == play(mechanism, long, gentle)
    far = direction * 0.9 * short["turn_range"]
    told = [*gentle, {mechanism.key: far}, {mechanism.key: far, mechanism.final: 0.5 * UPPER[mechanism.key]}]
    assert play(mechanism, short, told)[:-1] == play(mechanism, long, told)[:-1], (
        "a turn alone does not tell that it is enough"
    )
    assert play(mechanism, short, told)[-1] != play(mechanism, long, told)[-1]


@both
@given(directions, fractions, directions, fractions)
@some
def test_at_rest_all_are_alike_shut_and_not_open(
    mechanism: TurnToOpenMechanism, one: int, first: float, other: int, second: float
) -> None:
    for draw in (hidden(mechanism, one, first), hidden(mechanism, other, second)):
        assert limits_after(mechanism, draw, {}, {})[mechanism.final] == (0.0, 0.0)
        (joints,) = play(mechanism, draw, [{}])
        assert joints == {mechanism.key: 0.0, mechanism.final: 0.0}
        assert not mechanism.succeeded(reading(joints)).item()


@both
@given(directions, fractions)
@some
def test_turning_it_there_and_opening_it_is_success(
    mechanism: TurnToOpenMechanism, direction: int, fraction: float
) -> None:
    draw = hidden(mechanism, direction, fraction)
    turned, opened = {mechanism.key: direction * 9.0}, {mechanism.key: direction * 9.0, mechanism.final: 9.0}
    assert not mechanism.succeeded(reading(play(mechanism, draw, [opened])[-1])).item(), "not in one: it was shut"
    assert not mechanism.succeeded(reading(play(mechanism, draw, [turned])[-1])).item(), "turning it opens nothing"
    assert mechanism.succeeded(reading(play(mechanism, draw, [turned, opened])[-1])).item()
    wrong = [{mechanism.key: -direction * 9.0}, {mechanism.key: -direction * 9.0, mechanism.final: 9.0}]
    assert not mechanism.succeeded(reading(play(mechanism, draw, wrong)[-1])).item()


def test_draw_frequencies_are_as_configured() -> None:
    count = 4000
    config = TurnToOpenMechanismConfig(p_positive=0.8, range_fraction=(0.6, 0.9))
    mechanism = TurnToOpenMechanism("cap", "lift", key_range=2.0, final_upper=0.05, success=0.025, config=config)
    state = mechanism.draw(count, generator())
    draws = [mechanism.hidden(state, i) for i in range(count)]
    assert sum(draw["direction"] == 1 for draw in draws) / count == pytest.approx(0.8, abs=0.03)
    ranges = torch.tensor([draw["turn_range"] for draw in draws]) / 2.0
    assert 0.6 <= ranges.min() < 0.605
    assert 0.895 < ranges.max() <= 0.9
    assert ranges.mean() == pytest.approx(0.75, abs=0.005)
    positive = torch.tensor([draw["direction"] == 1 for draw in draws])
    assert abs(ranges[positive].mean() - ranges[~positive].mean()) < 0.02, "draws are independent"


def test_its_rules_tell_the_numbers_it_was_configured_with() -> None:
    config = TurnToOpenMechanismConfig(p_positive=0.3, range_fraction=(0.6, 0.9), release_fraction=0.75)
    mechanism = TurnToOpenMechanism("cap", "lift", key_range=2.0, final_upper=0.05, success=0.025, config=config)
    words = " ".join(mechanism.rules().values())
    assert all(number in words for number in ("0.3", "0.6", "0.9", "0.75", "cap", "lift"))
    assert limits_after(mechanism, {"direction": 1, "turn_range": 1.0}, {"cap": 0.76})["lift"] == (0.0, 0.05)


@pytest.mark.parametrize(
    "overrides",
    [{"direction": 0}, {"direction": 2}, {"direction": "left"}, {"turn_range": 0.0}, {"turn_range": math.inf},
     {"turn_range": True}, {"locked": True}, {"knob_range": 1.0}],
)  # fmt: skip
def test_a_wrong_override_is_refused_with_what_is_allowed(overrides: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="allowed:"):
        CAP.draw(1, generator(), overrides)


@pytest.mark.parametrize(
    "options",
    [{"key_range": 0.0}, {"key_range": math.nan}, {"final_upper": -0.05}, {"config": TurnToOpenMechanismConfig(1.5)},
     {"config": TurnToOpenMechanismConfig(range_fraction=(0.9, 0.5))},
     {"config": TurnToOpenMechanismConfig(release_fraction=0.0)}],
)  # fmt: skip
def test_what_cannot_work_is_refused(options: dict[str, Any]) -> None:
    sizes: dict[str, Any] = {"key_range": 2.0, "final_upper": 0.05, "success": 0.025}
    with pytest.raises(ConfigurationError, match="allowed:"):
        TurnToOpenMechanism("cap", "lift", **(sizes | options))
