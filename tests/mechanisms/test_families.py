"""The families by themselves: lock, switch contact, random direction, rotate then slide, push or rotate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from lerobot_adamanip.mechanisms import (
    Lock,
    PushOrRotate,
    RandomRotationDirection,
    RotateThenSlide,
    SwitchContact,
    replace_rows,
)
from lerobot_adamanip.util.errors import ConfigurationError

SLIDE = 0.05


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def one(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


def rotate_slide(latched: bool) -> RotateThenSlide:
    return RotateThenSlide(RandomRotationDirection(2.35), SLIDE, latched=latched)


def slide_limit(mechanism: RotateThenSlide, state: Any, *readings: tuple[float, float]) -> float:
    for turn, slide in readings:
        state, _, limits = mechanism.step(state, one(turn), one(slide))
    return float(limits.upper)


FORCED: dict[str, Any] = {"direction": 1, "turn_range": 2.0}
latched_or_not = pytest.mark.parametrize("latched", [True, False], ids=["latched", "not latched"])


@latched_or_not
@given(st.lists(st.tuples(st.floats(-1.69, 1.69), st.floats(-1, 1)), min_size=1, max_size=8))
@settings(max_examples=40, deadline=None)
def test_nothing_slides_by_force(latched: bool, readings: list[tuple[float, float]]) -> None:
    mechanism = rotate_slide(latched)
    assert slide_limit(mechanism, mechanism.draw(1, generator(), FORCED), *readings) == 0.0


@latched_or_not
def test_the_slide_is_free_from_the_release_angle_on(latched: bool) -> None:
    mechanism = rotate_slide(latched)
    state = mechanism.draw(1, generator(), FORCED)
    assert slide_limit(mechanism, state, (1.69, 0.0)) == 0.0
    assert slide_limit(mechanism, state, (1.71, 0.0)) == SLIDE


def test_turning_back_holds_the_slide_only_where_it_is_not_latched() -> None:
    there_and_back = ((1.9, 0.0), (0.5, 0.0))
    for latched, limit in ((True, SLIDE), (False, 0.0)):
        mechanism = rotate_slide(latched)
        assert slide_limit(mechanism, mechanism.draw(1, generator(), FORCED), *there_and_back) == limit


def test_what_has_slid_out_is_not_slammed_back_but_held_again_once_it_is_in() -> None:
    mechanism = rotate_slide(latched=False)
    state = mechanism.draw(1, generator(), FORCED)
    assert slide_limit(mechanism, state, (1.9, 0.0), (1.9, 0.03), (0.5, 0.03)) == SLIDE
    assert slide_limit(mechanism, state, (1.9, 0.0), (1.9, 0.03), (0.5, 0.03), (0.5, 0.0), (0.5, 0.03)) == 0.0


@given(st.lists(st.floats(-0.84, 0.84), max_size=10))
@settings(max_examples=40, deadline=None)
def test_the_release_angle_does_not_show_before_it_is_reached(fractions: list[float]) -> None:
    mechanism = rotate_slide(latched=True)
    states = [mechanism.draw(1, generator(), {"direction": 1, "turn_range": value}) for value in (1.5, 2.3)]
    for fraction in fractions:
        slides = []
        for i, state in enumerate(states):
            states[i], _, limits = mechanism.step(state, one(1.5 * fraction), one(0.0))
            slides.append(float(limits.upper))
        assert slides == [0.0, 0.0]


@given(st.integers(0, 1000), st.floats(0, 1))
@settings(max_examples=40, deadline=None)
def test_a_rotation_is_free_on_the_drawn_side_only(seed: int, p: float) -> None:
    rotation = RandomRotationDirection(1.57, p)
    state = rotation.draw(32, generator(seed))
    limits = rotation.limits(state)
    assert torch.all((limits.lower == 0) ^ (limits.upper == 0))
    assert torch.equal(limits.upper > 0, state.direction > 0)
    assert torch.allclose(limits.upper - limits.lower, state.turn_range)
    assert torch.all((state.turn_range >= 0.5 * 1.57) & (state.turn_range <= 1.57))


@pytest.mark.parametrize(("p", "direction"), [(0.0, -1), (1.0, 1)])
def test_a_direction_can_be_fixed(p: float, direction: int) -> None:
    state = RandomRotationDirection(0.8, p).draw(200, generator())
    assert torch.all(state.direction == direction)


def test_push_or_rotate_frees_exactly_one_motion_each_a_third_of_the_time() -> None:
    lamp = PushOrRotate(0.1, 1.57)
    state = lamp.draw(3000, generator())
    push, turn = lamp.limits(state)
    free = torch.stack([push.upper > 0, turn.upper > 0, turn.lower < 0])
    assert torch.all(free.sum(0) == 1)
    assert torch.allclose(free.double().mean(1), torch.full((3,), 1 / 3, dtype=torch.float64), atol=0.03)
    assert torch.all(push.lower == 0)


@pytest.mark.parametrize(("mode", "expected"), [(0, (0.1, 0.0, 0.0)), (1, (0.0, 0.0, 1.57)), (2, (0.0, -1.57, 0.0))])
def test_each_mode_is_the_motion_it_is_called(mode: int, expected: tuple[float, float, float]) -> None:
    lamp = PushOrRotate(0.1, 1.57)
    push, turn = lamp.limits(lamp.draw(1, generator(), {"mode": mode}))
    assert (float(push.upper), float(turn.lower), float(turn.upper)) == expected


def test_a_button_may_be_the_key_and_releases_at_its_own_fraction() -> None:
    travel = one(0.03)
    microwave = SwitchContact(1.578, release_fraction=0.7)
    state = microwave.draw(1, generator(), {"locked": True})
    state, limits = microwave.step(state, one(0.69 * 0.03), travel)
    assert float(limits.upper) == 0.0
    state, limits = microwave.step(state, one(0.71 * 0.03), travel)
    assert float(limits.upper) == 1.578
    assert float(microwave.step(state, one(0.0), travel)[1].upper) == 1.578


def test_a_latch_that_is_always_locked_is_a_lock_with_certainty() -> None:
    assert Lock(1.57, p_locked=1.0).draw(200, generator()).locked.all()


DRAWS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "lock": (Lock(1.0).draw, {"locked": True}),
    "switch contact": (SwitchContact(1.0).draw, {"locked": False}),
    "rotation": (RandomRotationDirection(1.0).draw, {"direction": -1, "turn_range": 0.7}),
    "rotate then slide": (rotate_slide(latched=True).draw, {"direction": 1}),
    "push or rotate": (PushOrRotate(0.1, 1.0).draw, {"mode": 2}),
}
every_family = pytest.mark.parametrize(("draw", "overrides"), DRAWS.values(), ids=DRAWS)


@every_family
def test_overrides_take_as_many_random_numbers_as_draws(draw: Callable[..., Any], overrides: dict[str, Any]) -> None:
    free, fixed = generator(3), generator(3)
    draw(5, free)
    draw(5, fixed, overrides)
    assert torch.equal(free.get_state(), fixed.get_state())


@every_family
def test_draws_follow_the_seed_and_use_no_other_source(draw: Callable[..., Any], overrides: dict[str, Any]) -> None:
    first = draw(9, generator(3))
    torch.manual_seed(99)
    global_state = torch.get_rng_state()
    assert repr(draw(9, generator(3))) == repr(first)
    assert torch.equal(torch.get_rng_state(), global_state)
    assert repr(draw(9, generator(4))) != repr(first)


@every_family
def test_rows_of_every_state_can_be_reset(draw: Callable[..., Any], overrides: dict[str, Any]) -> None:
    old, fresh = draw(4, generator(1)), draw(4, generator(2))
    assert repr(replace_rows(old, fresh, torch.zeros(4, dtype=torch.bool))) == repr(old)
    assert repr(replace_rows(old, fresh, torch.ones(4, dtype=torch.bool))) == repr(fresh)


@pytest.mark.parametrize(
    "build",
    [
        lambda: Lock(0.0), lambda: Lock(1.0, release_fraction=0.0), lambda: Lock(1.0, p_locked=-0.1),
        lambda: SwitchContact(1.0, lock_fraction=0.0), lambda: RandomRotationDirection(-1.0),
        lambda: RandomRotationDirection(1.0, range_fraction=(1.0, 0.5)), lambda: RandomRotationDirection(float("nan")),
        lambda: RotateThenSlide(RandomRotationDirection(1.0), 0.0),
        lambda: RotateThenSlide(RandomRotationDirection(1.0), release_fraction=1.5),
        lambda: PushOrRotate(0.0, 1.0), lambda: PushOrRotate(0.1, float("inf")),
        lambda: PushOrRotate(0.1, 1.0).draw(1, generator(), {"mode": 3}),
    ],
)  # fmt: skip
def test_what_cannot_work_is_refused(build: Callable[[], Any]) -> None:
    with pytest.raises(ConfigurationError, match="allowed:"):
        build()
