"""Bottle labels: paper and print wrapped around the body, as decoration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.bottle.recipes import LABEL_INKS, LABEL_PAPERS, Color
from lerobot_adamanip.objects.geometry.lathe import Curves, Ring, decal, oval, patch, ring_at


@dataclass(frozen=True)
class Label:
    """A label: kind, colours of paper, ink and accent, and height as a fraction of the body's."""

    kind: str
    paper: Color
    ink: Color
    accent: Color
    share: float


def draw_label(rng: np.random.Generator, kind: str) -> Label:
    """Samples a label of a kind, with ink that contrasts with the paper."""
    plain = kind in ("pharmacy", "classic", "estate", "dairy")
    paper = LABEL_PAPERS[rng.integers(3 if plain else len(LABEL_PAPERS))]
    if kind == "pharmacy":
        paper = LABEL_PAPERS[1]
    readable = [ink for ink in LABEL_INKS if max(abs(a - b) for a, b in zip(ink, paper, strict=True)) > 0.45]
    first, second = rng.permutation(len(readable))[:2]
    return Label(kind, paper, readable[first], readable[second], rng.uniform(0.48, 0.62))


def label_shapes(label: Label, rings: Sequence[Ring], shoulder: float, axis: tuple[float, float]) -> tuple[Shape, ...]:
    """Returns the pictures of a label around a body with its shoulder at ``shoulder`` [m]."""
    colors = {"paper": label.paper, "ink": label.ink, "accent": label.accent}
    middle, height = 0.48 * shoulder, label.share * shoulder
    prints = _prints(label.kind, middle, height, ring_at(rings, middle).radius)
    return tuple(
        decal(rings, curves, Material(colors[color], 0.7), layer=layer, axis=axis) for color, layer, curves in prints
    )


Print = tuple[str, int, Curves]
"""Colour, layer and outline of one print."""
Bar = tuple[str, int, float, float, float]
"""Colour, layer, width, lower and upper edge."""
Oval = tuple[str, int, str, float, float, float]
"""Colour, layer, ``oval`` or ``rhombus``, width, height and middle."""
Lines = tuple[float, float, int, float]
"""Simulated small print: middle of the first line, width, number of lines, pitch."""
Drawn = Callable[[float, float, float], list[Print]]
"""Function that draws a print around a middle, for a label's height and a body's radius [m]."""


def _prints(kind: str, middle: float, height: float, width: float) -> Iterator[Print]:
    unit_width, unit_height, rows = _PRINTS[kind]
    wide, high = unit_width * width, unit_height * height
    for row in rows:
        match row:
            case str(color), int(layer), str(shape), across, tall, at:
                yield color, layer, oval(across * wide, tall * high, middle + at * high, sharp=shape == "rhombus")
            case str(color), int(layer), across, low, top:
                yield _bar(color, layer, across * wide, middle + low * high, middle + top * high)
            case float(first), across, int(count), pitch:
                yield from _lines(middle + first * high, across * wide, count, pitch * high)
            case draw if callable(draw):
                yield from draw(middle, height, width)


def _bar(color: str, layer: int, width: float, bottom: float, top: float) -> Print:
    return color, layer, patch(width, bottom, top, 65 if width > 0.12 else 25)


def _lines(middle: float, width: float, count: int, pitch: float) -> Iterator[Print]:
    for row in range(count):
        z = middle - row * pitch
        yield "ink", 2, patch(width * (0.95, 0.7, 0.85)[row % 3], z - 0.0007, z + 0.0007, 7)


def _waves(middle: float, height: float, width: float) -> list[Print]:
    around = np.linspace(-np.pi, np.pi, 65) * width
    swing = 0.12 * height * np.sin(2 * around / width)
    half = 0.36 * height
    return [
        ("paper", 1, (around, np.full(65, middle - half), np.full(65, middle + half))),
        ("ink", 2, (around, middle + swing - 0.10 * height, middle + swing + 0.10 * height)),
        ("accent", 2, (around, middle + swing - 0.20 * height, middle + swing - 0.14 * height)),
    ]


def _hills(middle: float, height: float, width: float) -> list[Print]:
    around = np.linspace(-np.pi, np.pi, 65) * width
    hills = middle - 0.20 * height + 0.06 * height * np.cos(3 * around / width)
    low = np.full(65, middle - 0.42 * height)
    return [
        ("paper", 1, (around, low, np.full(65, middle + 0.36 * height))),
        ("accent", 2, (around, low, hills)),
    ]


def _pointed(middle: float, height: float, width: float) -> list[Print]:
    across = np.linspace(-0.7 * width, 0.7 * width, 25)
    point = middle - 0.5 * height * (1 - 0.55 * np.abs(across / (0.7 * width)) ** 2)
    return [("paper", 1, (across, point, np.full(25, middle + 0.46 * height)))]


def _cross(middle: float, height: float, width: float) -> list[Print]:
    """Returns a cross with the name beside it."""
    arm, left, at = 0.05 * height, -0.62 * width, middle + 0.28 * height
    across, lower, upper = patch(3 * arm, 0, 0, 5)
    return [
        ("accent", 2, (across + left, lower + at - arm / 2, upper + at + arm / 2)),
        ("accent", 2, (across / 3 + left, lower + at - 1.5 * arm, upper + at + 1.5 * arm)),
        _bar("ink", 2, 0.72 * width, at - 0.05 * height, at + 0.05 * height),
    ]


def _badge(middle: float, height: float, width: float) -> list[Print]:
    at = middle + 0.2 * height
    return [
        ("ink", 1, oval(0.6 * width, 0.6 * width, at)),
        ("paper", 2, oval(0.36 * width, 0.36 * width, at, sharp=True)),
        *_lines(at - 0.45 * width, 0.5 * width, 1, 0.01),
    ]


_PRINTS: dict[str, tuple[float, float, tuple[Bar | Oval | Lines | Drawn, ...]]] = {
    "estate": (1.5, 1.0, (
        ("paper", 1, 1.0, -0.5, 0.5), ("accent", 2, 1.0, -0.44, -0.38), ("accent", 2, "oval", 0.5, 0.26, 0.26),
        ("paper", 3, "rhombus", 0.36, 0.18, 0.26), ("ink", 2, 0.8, -0.04, 0.04), (-0.14, 0.6, 3, 0.07),
    )),
    "classic": (1.7, 1.0, (
        ("paper", 1, 1.0, -0.5, 0.5), ("accent", 2, 1.0, 0.30, 0.42), ("ink", 2, 0.75, 0.02, 0.14),
        ("ink", 2, 0.5, -0.14, -0.06), (-0.24, 0.6, 3, 0.07),
    )),
    "band": (1.0, 0.34, (
        ("paper", 1, 2 * np.pi, -1.0, 1.0), ("accent", 2, 2 * np.pi, -1.0, -0.8), ("accent", 2, 2 * np.pi, 0.8, 1.0),
        ("ink", 2, "oval", 1.3, 1.1, 0.0), ("paper", 3, "oval", 0.9, 0.36, 0.0),
    )),
    "wave": (1.0, 1.0, (_waves,)),
    "dairy": (1.0, 1.0, (_hills, ("ink", 3, "oval", 1.25, 0.36, 0.08), ("paper", 4, "oval", 0.9, 0.10, 0.08))),
    "oval": (1.0, 1.0, (
        ("paper", 1, "oval", 1.35, 0.95, 0.0), ("ink", 2, "oval", 1.05, 0.42, 0.05),
        ("paper", 3, "oval", 0.75, 0.12, 0.05), (-0.25, 0.6, 2, 0.08),
    )),
    "shield": (1.0, 1.0, (
        _pointed, ("ink", 2, 1.4, 0.06, 0.28), ("accent", 2, "oval", 0.5, 0.26, -0.18), ("paper", 3, 0.95, 0.13, 0.21),
    )),
    "diamond": (1.0, 1.0, (
        ("paper", 1, "rhombus", 1.7, 1.05, 0.0), ("ink", 2, "rhombus", 1.4, 0.85, 0.0),
        ("paper", 3, "oval", 0.9, 0.10, 0.0), ("accent", 3, "oval", 0.4, 0.16, 0.16),
    )),
    "minimal": (1.0, 1.0, (("ink", 1, 0.8, 0.28, 0.34), (0.16, 0.5, 2, 0.07), ("accent", 1, 0.4, -0.36, -0.34))),
    "pharmacy": (2.0, 1.0, (
        ("paper", 1, 1.0, -0.5, 0.5), ("accent", 2, 1.0, -0.5, -0.40), _cross, (0.08, 0.75, 5, 0.08),
    )),
    "badge": (1.0, 1.0, (_badge,)),
}  # fmt: skip
"""Kind -> width and height, as fractions of the body's radius and the label's height, and the rows in these units."""
