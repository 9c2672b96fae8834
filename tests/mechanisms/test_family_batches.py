"""Every family, batched: order does not matter, neighbours do not matter, and arguments stay as they are."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
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

BATCH = 6
RANGE = torch.full((BATCH,), 1.5, dtype=torch.float64)
LOCK, TURN_LOCKS = Lock(1.57), SwitchContact(1.57, lock_on_turn=True)
ROTATION, LAMP = RandomRotationDirection(1.5), PushOrRotate(0.1, 1.57)
SLIDE = RotateThenSlide(ROTATION, latched=False)
Step = Callable[[Any, Tensor, Tensor], tuple[Any, ...]]
FAMILIES: dict[str, tuple[Any, Step]] = {
    "lock": (LOCK, lambda state, a, b: LOCK.step(state, a, RANGE[: len(a)])),
    "switch contact": (TURN_LOCKS, lambda state, a, b: TURN_LOCKS.step_with(state, a, RANGE[: len(a)], b)),
    "rotation": (ROTATION, lambda state, a, b: (state, ROTATION.limits(state))),
    "rotate then slide": (SLIDE, SLIDE.step),
    "push or rotate": (LAMP, lambda state, a, b: (state, *LAMP.limits(state))),
}
every_family = pytest.mark.parametrize(("family", "step"), FAMILIES.values(), ids=FAMILIES)


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def readings(seed: int) -> tuple[Tensor, Tensor]:
    both = torch.rand(2, BATCH, generator=generator(seed), dtype=torch.float64) * 4 - 2
    return both[0], both[1] / 10


def take(thing: Any, rows: Tensor) -> Any:
    if isinstance(thing, Tensor):
        return thing[rows]
    if isinstance(thing, tuple):
        return tuple(take(item, rows) for item in thing)
    return replace(thing, **{item.name: take(getattr(thing, item.name), rows) for item in fields(thing)})


def bits(thing: Any) -> list[tuple[torch.dtype, bytes]]:
    if isinstance(thing, Tensor):
        return [(thing.dtype, thing.numpy().tobytes())]
    parts = [getattr(thing, item.name) for item in fields(thing)] if is_dataclass(thing) else thing
    return [leaf for part in parts for leaf in bits(part)]


@every_family
@given(st.permutations(range(BATCH)), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_batch_order_does_not_matter(family: Any, step: Step, order: list[int], seed: int) -> None:
    rows, (a, b) = torch.tensor(order), readings(seed)
    state = step(family.draw(BATCH, generator(seed)), *readings(seed + 1))[0]
    assert bits(take(step(state, a, b), rows)) == bits(step(take(state, rows), a[rows], b[rows]))


@every_family
@given(st.integers(0, BATCH - 1), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_an_environment_goes_on_alone_as_it_would_among_others(family: Any, step: Step, row: int, seed: int) -> None:
    only, (a, b) = torch.tensor([row]), readings(seed)
    state = family.draw(BATCH, generator(seed))
    assert bits(take(step(state, a, b), only)) == bits(step(take(state, only), a[only], b[only]))


@every_family
@given(st.lists(st.booleans(), min_size=BATCH, max_size=BATCH), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_resetting_some_leaves_the_others_bit_identical(family: Any, step: Step, resets: list[bool], seed: int) -> None:
    mask, (a, b) = torch.tensor(resets), readings(seed)
    state = step(family.draw(BATCH, generator(seed)), *readings(seed + 1))[0]
    fresh = family.draw(BATCH, generator(seed + 2))
    mixed = replace_rows(state, fresh, mask)
    assert bits(take(step(mixed, a, b), ~mask)) == bits(take(step(state, a, b), ~mask))
    assert bits(take(step(mixed, a, b), mask)) == bits(take(step(fresh, a, b), mask))


@every_family
def test_a_step_changes_no_argument_and_draws_nothing(family: Any, step: Step) -> None:
    state, (a, b) = family.draw(BATCH, generator(0)), readings(1)
    before, random_state = copy.deepcopy((state, a, b)), torch.get_rng_state()
    first = step(state, a, b)
    assert bits((state, a, b)) == bits(before)
    assert bits(step(state, a, b)) == bits(first)
    assert torch.equal(torch.get_rng_state(), random_state)
