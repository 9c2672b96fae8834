"""Designs that are drawn: each field of a dataclass says from what, and fields are drawn in the order they stand in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, fields
from types import SimpleNamespace
from typing import Any

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject


def draw[Design](design: Callable[..., Design], rng: np.random.Generator) -> Design:
    """Draws the fields of a dataclass."""
    values = SimpleNamespace()
    for each in fields(design):  # type: ignore[arg-type]
        setattr(values, each.name, each.metadata["draw"](rng, values))
    return design(**vars(values))


def computed(draw_value: Callable[[np.random.Generator, Any], object]) -> Any:
    """A field drawn by a function of the generator and of the fields above, which it has as attributes."""
    return field(metadata={"draw": draw_value})


def uniform(low: float, high: float) -> Any:
    """A number from a range."""
    return computed(lambda rng, _: rng.uniform(low, high))


def chosen(words: Sequence[str], p: Sequence[float] | None = None) -> Any:
    """A word, with probabilities ``p`` if they differ."""
    return computed(lambda rng, _: str(rng.choice(words, p=p)))


def picked(values: Sequence[object]) -> Any:
    """One of some values that are no words."""
    return computed(lambda rng, _: values[int(rng.integers(len(values)))])


def shaded(colors: Sequence[Sequence[float]], low: float, high: float) -> Any:
    """One of some colours (3,), times a brightness from a range."""
    return computed(lambda rng, _: np.asarray(colors[int(rng.integers(len(colors)))]) * rng.uniform(low, high))


def chance(share: float) -> Any:
    """True with this probability."""
    return computed(lambda rng, _: bool(rng.random() < share))


def either_side() -> Any:
    """-1 or 1."""
    return computed(lambda rng, _: int(rng.choice([-1, 1])))


def makers[Design](
    category: str,
    stream: int,
    design: Callable[..., Design],
    draw_novel: Callable[[np.random.Generator], Design],
    build: Callable[[str, Design], ArticulatedObject],
) -> tuple[Callable[[int], ArticulatedObject], Callable[[int], ArticulatedObject]]:
    """Returns what builds a category's objects by number: the seen and unseen ones, and the novel ones.

    They are drawn by a generator that is seeded by the number and by ``stream``, the category's own.
    """

    def make(number: int) -> ArticulatedObject:
        return build(f"{category}_{number:03d}", draw(design, np.random.default_rng([number, stream])))

    def make_novel(number: int) -> ArticulatedObject:
        return build(f"{category}_n{number:03d}", draw_novel(np.random.default_rng([number, stream, 1])))

    return make, make_novel
