"""Labels of bottles: paper and print wrapped on the body, as decoration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.bottle.recipes import LABEL_INKS, LABEL_PAPERS, Color
from lerobot_adamanip.objects.geometry.lathe import Curves, Ring, decal, oval, patch, ring_at


@dataclass(frozen=True)
class Label:
    """A label: its kind, the colours of paper, ink and accent, and its height as a fraction of the body's."""

    kind: str
    paper: Color
    ink: Color
    accent: Color
    share: float


def draw_label(rng: np.random.Generator, kind: str) -> Label:
    """Draws a label of a kind; what is printed can be read against the paper."""
    plain = kind in ("pharmacy", "classic", "estate", "dairy")
    paper = LABEL_PAPERS[rng.integers(3 if plain else len(LABEL_PAPERS))]
    if kind == "pharmacy":
        paper = LABEL_PAPERS[1]
    readable = [ink for ink in LABEL_INKS if max(abs(a - b) for a, b in zip(ink, paper, strict=True)) > 0.45]
    first, second = rng.permutation(len(readable))[:2]
    return Label(kind, paper, readable[first], readable[second], rng.uniform(0.48, 0.62))


def label_shapes(label: Label, rings: Sequence[Ring], shoulder: float, axis: tuple[float, float]) -> tuple[Shape, ...]:
    """Returns the pictures of a label around a body that ends at ``shoulder`` [m]."""
    middle, height = 0.48 * shoulder, label.share * shoulder
    width = ring_at(rings, middle).radius
    curves = _PRINTS[label.kind](middle, height, width)
    colors = {"paper": label.paper, "ink": label.ink, "accent": label.accent}
    return tuple(
        decal(rings, curve, Material(colors[name], 0.7), layer=layer, axis=axis) for name, layer, curve in curves
    )


Print = tuple[str, int, Curves]
"""Colour, layer and outline of one print."""


def _lines(middle: float, width: float, count: int, pitch: float, name: str = "ink") -> list[Print]:
    """Print too small to read."""
    rows: list[Print] = []
    for row in range(count):
        z = middle - row * pitch
        across, lower, upper = patch(width * (0.95, 0.7, 0.85)[row % 3], z - 0.0007, z + 0.0007, 7)
        rows.append((name, 2, (across, lower, upper)))
    return rows


def _bar(name: str, layer: int, width: float, bottom: float, top: float) -> Print:
    columns = 65 if width > 0.12 else 25
    return name, layer, patch(width, bottom, top, columns)


def _estate(middle: float, height: float, width: float) -> list[Print]:
    w = 1.5 * width
    return [
        _bar("paper", 1, w, middle - height / 2, middle + height / 2),
        _bar("accent", 2, w, middle - 0.44 * height, middle - 0.38 * height),
        ("accent", 2, oval(0.5 * w, 0.26 * height, middle + 0.26 * height)),
        ("paper", 3, oval(0.36 * w, 0.18 * height, middle + 0.26 * height, sharp=True)),
        _bar("ink", 2, 0.8 * w, middle - 0.04 * height, middle + 0.04 * height),
        *_lines(middle - 0.14 * height, 0.6 * w, 3, 0.07 * height),
    ]


def _classic(middle: float, height: float, width: float) -> list[Print]:
    w = 1.7 * width
    return [
        _bar("paper", 1, w, middle - height / 2, middle + height / 2),
        _bar("accent", 2, w, middle + 0.30 * height, middle + 0.42 * height),
        _bar("ink", 2, 0.75 * w, middle + 0.02 * height, middle + 0.14 * height),
        _bar("ink", 2, 0.5 * w, middle - 0.14 * height, middle - 0.06 * height),
        *_lines(middle - 0.24 * height, 0.6 * w, 3, 0.07 * height),
    ]


def _wave(middle: float, height: float, width: float) -> list[Print]:
    around = np.linspace(-np.pi, np.pi, 65) * width
    swing = 0.12 * height * np.sin(2 * around / width)
    half = 0.36 * height
    return [
        ("paper", 1, (around, np.full(65, middle - half), np.full(65, middle + half))),
        ("ink", 2, (around, middle + swing - 0.10 * height, middle + swing + 0.10 * height)),
        ("accent", 2, (around, middle + swing - 0.20 * height, middle + swing - 0.14 * height)),
    ]


def _band(middle: float, height: float, width: float) -> list[Print]:
    full, half = 2 * np.pi * width, 0.34 * height
    return [
        _bar("paper", 1, full, middle - half, middle + half),
        _bar("accent", 2, full, middle - half, middle - 0.8 * half),
        _bar("accent", 2, full, middle + 0.8 * half, middle + half),
        ("ink", 2, oval(1.3 * width, 1.1 * half, middle)),
        ("paper", 3, oval(0.9 * width, 0.36 * half, middle)),
    ]


def _dairy(middle: float, height: float, width: float) -> list[Print]:
    around = np.linspace(-np.pi, np.pi, 65) * width
    hills = middle - 0.20 * height + 0.06 * height * np.cos(3 * around / width)
    return [
        ("paper", 1, (around, np.full(65, middle - 0.42 * height), np.full(65, middle + 0.36 * height))),
        ("accent", 2, (around, np.full(65, middle - 0.42 * height), hills)),
        ("ink", 3, oval(1.25 * width, 0.36 * height, middle + 0.08 * height)),
        ("paper", 4, oval(0.9 * width, 0.10 * height, middle + 0.08 * height)),
    ]


def _oval_print(middle: float, height: float, width: float) -> list[Print]:
    return [
        ("paper", 1, oval(1.35 * width, 0.95 * height, middle)),
        ("ink", 2, oval(1.05 * width, 0.42 * height, middle + 0.05 * height)),
        ("paper", 3, oval(0.75 * width, 0.12 * height, middle + 0.05 * height)),
        *_lines(middle - 0.25 * height, 0.6 * width, 2, 0.08 * height),
    ]


def _shield(middle: float, height: float, width: float) -> list[Print]:
    across = np.linspace(-0.7 * width, 0.7 * width, 25)
    point = middle - 0.5 * height * (1 - 0.55 * np.abs(across / (0.7 * width)) ** 2)
    return [
        ("paper", 1, (across, point, np.full(25, middle + 0.46 * height))),
        _bar("ink", 2, 1.4 * width, middle + 0.06 * height, middle + 0.28 * height),
        ("accent", 2, oval(0.5 * width, 0.26 * height, middle - 0.18 * height)),
        _bar("paper", 3, 0.95 * width, middle + 0.13 * height, middle + 0.21 * height),
    ]


def _diamond(middle: float, height: float, width: float) -> list[Print]:
    return [
        ("paper", 1, oval(1.7 * width, 1.05 * height, middle, sharp=True)),
        ("ink", 2, oval(1.4 * width, 0.85 * height, middle, sharp=True)),
        ("paper", 3, oval(0.9 * width, 0.10 * height, middle)),
        ("accent", 3, oval(0.4 * width, 0.16 * height, middle + 0.16 * height)),
    ]


def _minimal(middle: float, height: float, width: float) -> list[Print]:
    return [
        _bar("ink", 1, 0.8 * width, middle + 0.28 * height, middle + 0.34 * height),
        *_lines(middle + 0.16 * height, 0.5 * width, 2, 0.07 * height),
        _bar("accent", 1, 0.4 * width, middle - 0.36 * height, middle - 0.34 * height),
    ]


def _pharmacy(middle: float, height: float, width: float) -> list[Print]:
    w, arm = 2.0 * width, 0.05 * height
    left = -0.62 * width
    across, lower, upper = patch(3 * arm, 0, 0, 5)
    cross = middle + 0.28 * height
    return [
        _bar("paper", 1, w, middle - height / 2, middle + height / 2),
        _bar("accent", 2, w, middle - 0.5 * height, middle - 0.40 * height),
        ("accent", 2, (across + left, lower + cross - arm / 2, upper + cross + arm / 2)),
        ("accent", 2, (across / 3 + left, lower + cross - 1.5 * arm, upper + cross + 1.5 * arm)),
        _bar("ink", 2, 0.72 * width, cross - 0.05 * height, cross + 0.05 * height),
        *_lines(middle + 0.08 * height, 0.75 * w, 5, 0.08 * height),
    ]


def _badge(middle: float, height: float, width: float) -> list[Print]:
    return [
        ("ink", 1, oval(0.6 * width, 0.6 * width, middle + 0.2 * height)),
        ("paper", 2, oval(0.36 * width, 0.36 * width, middle + 0.2 * height, sharp=True)),
        *_lines(middle + 0.2 * height - 0.45 * width, 0.5 * width, 1, 0.01),
    ]


_PRINTS = {
    "estate": _estate, "classic": _classic, "wave": _wave, "band": _band, "dairy": _dairy, "oval": _oval_print,
    "shield": _shield, "diamond": _diamond, "minimal": _minimal, "pharmacy": _pharmacy, "badge": _badge,
}  # fmt: skip
