"""Random designs: dataclass fields that declare their distribution, sampled in field order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, fields
from types import SimpleNamespace
from typing import Any

import numpy as np

from lerobot_adamanip.objects.base import ArticulatedObject


def draw[Design](design: Callable[..., Design], rng: np.random.Generator) -> Design:
    """Samples the fields of a dataclass."""
    values = SimpleNamespace()
    for each in fields(design):  # type: ignore[arg-type]
        setattr(values, each.name, each.metadata["draw"](rng, values))
    return design(**vars(values))


def computed(draw_value: Callable[[np.random.Generator, Any], object]) -> Any:
    """Returns a field computed from the generator and from the fields above it (as attributes)."""
    return field(metadata={"draw": draw_value})


def uniform(low: float, high: float) -> Any:
    """Returns a field with a uniformly sampled number."""
    return computed(lambda rng, _: rng.uniform(low, high))


def chosen(words: Sequence[str], p: Sequence[float] | None = None) -> Any:
    """Returns a field with a sampled word, with probabilities ``p`` (default: equal)."""
    return computed(lambda rng, _: str(rng.choice(words, p=p)))


def picked(values: Sequence[object]) -> Any:
    """Returns a field with a sampled element of values that are not words."""
    return computed(lambda rng, _: values[int(rng.integers(len(values)))])


def shaded(colors: Sequence[Sequence[float]], low: float, high: float) -> Any:
    """Returns a field with a sampled colour (3,), multiplied by a sampled brightness."""
    return computed(lambda rng, _: np.asarray(colors[int(rng.integers(len(colors)))]) * rng.uniform(low, high))


def chance(share: float) -> Any:
    """Returns a field that is True with the given probability."""
    return computed(lambda rng, _: bool(rng.random() < share))


def either_side() -> Any:
    """Returns a field that is -1 or 1."""
    return computed(lambda rng, _: int(rng.choice([-1, 1])))


def makers[Design](
    category: str,
    stream: int,
    design: Callable[..., Design],
    draw_novel: Callable[[np.random.Generator], Design],
    build: Callable[[str, Design], ArticulatedObject],
) -> tuple[Callable[[int], ArticulatedObject], Callable[[int], ArticulatedObject]]:
    """Returns the builders of a category's objects by number: seen and unseen ones, and novel ones.

    Their generator is seeded with the number and with ``stream``, the category's own constant.
    """

    def make(number: int) -> ArticulatedObject:
        return build(f"{category}_{number:03d}", draw(design, np.random.default_rng([number, stream])))

    def make_novel(number: int) -> ArticulatedObject:
        return build(f"{category}_n{number:03d}", draw_novel(np.random.default_rng([number, stream, 1])))

    return make, make_novel
