"""Kinds of bottles: sizes of real products [m], their caps, colours and labels."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot_adamanip.objects.base import Material

Range = tuple[float, float]
Color = tuple[float, float, float]


@dataclass(frozen=True)
class Recipe:
    """A kind of bottle: sampled parameters and their ranges.

    Attributes:
        height: total height, including the cap.
        radius: largest half width.
        shoulder: upper end of the body, as a fraction of the height below the cap.
        neck: lower end of the neck, as a fraction of the height below the cap.
        rise: profile of the shoulder, ``round``, ``ogee`` or ``cone``.
        neck_radius: radius of the neck, as a fraction of the cap's.
        cap_radius, cap_height: radius and height of the gripped part.
        caps: kinds of cap.
        finishes: names of `FINISHES`.
        cap_colors: names of `PLASTICS` or `METALS`.
        labels: kinds of label.
        depth: extent front to back as a fraction of the width.
        squareness: squareness of the body's cross section.
        waist: depth of the body's waist, as a fraction of its radius.
        ribs: number of grooves around it.
        foot: radius of the rounded lower edge.
        taper: radius at the lower end, as a fraction of the shoulder's.
        handle: whether it has a jug handle at its side.
    """

    height: Range
    radius: Range
    shoulder: Range
    neck: Range
    rise: str
    neck_radius: Range
    cap_radius: Range
    cap_height: Range
    caps: tuple[str, ...]
    finishes: tuple[str, ...]
    cap_colors: tuple[str, ...]
    labels: tuple[str, ...]
    depth: Range = (1.0, 1.0)
    squareness: Range = (0.0, 0.0)
    waist: Range = (0.0, 0.0)
    ribs: tuple[int, ...] = (0,)
    foot: Range = (0.004, 0.007)
    taper: Range = (1.0, 1.0)
    handle: bool = False


RECIPES: dict[str, Recipe] = {
    "wine": Recipe(
        (0.275, 0.30), (0.036, 0.039), (0.62, 0.67), (0.80, 0.84), "ogee", (0.88, 0.94), (0.0145, 0.016),
        (0.042, 0.055), ("long",), ("green glass", "brown glass", "straw glass"), ("claret", "black", "gold", "navy"),
        ("estate", "classic"),
    ),
    "hock": Recipe(
        (0.28, 0.30), (0.035, 0.038), (0.38, 0.46), (0.88, 0.92), "ogee", (0.90, 0.95), (0.0145, 0.016),
        (0.040, 0.050), ("long",), ("green glass", "blue glass", "brown glass"), ("gold", "silver", "black", "claret"),
        ("estate",),
    ),
    "soda": Recipe(
        (0.20, 0.25), (0.031, 0.036), (0.58, 0.66), (0.91, 0.94), "ogee", (0.84, 0.92), (0.0140, 0.0155),
        (0.019, 0.022), ("fluted",), ("cola", "orange drink", "lemon drink", "berry drink"),
        ("red", "orange", "green", "white", "blue"), ("wave", "band"), waist=(0.07, 0.12), foot=(0.008, 0.012),
    ),
    "water": Recipe(
        (0.20, 0.25), (0.030, 0.035), (0.68, 0.74), (0.93, 0.95), "round", (0.82, 0.90), (0.0145, 0.016),
        (0.019, 0.022), ("fluted",), ("water", "blue water"), ("blue", "white", "sky", "pink"), ("band", "wave"),
        ribs=(5, 6, 7), foot=(0.005, 0.008),
    ),
    "milk": Recipe(
        (0.20, 0.24), (0.041, 0.045), (0.58, 0.64), (0.86, 0.90), "round", (0.86, 0.92), (0.019, 0.022),
        (0.020, 0.024), ("fluted",), ("milk", "pale plastic"), ("blue", "red", "green", "yellow"), ("dairy", "band"),
        squareness=(0.0, 0.25), handle=True,
    ),
    "ketchup": Recipe(
        (0.17, 0.21), (0.034, 0.038), (0.66, 0.74), (0.95, 0.97), "round", (0.86, 0.94), (0.021, 0.0245),
        (0.026, 0.034), ("flip",), ("red plastic", "yellow plastic", "cream plastic", "brown plastic"),
        ("white", "red", "green", "yellow", "navy"), ("shield", "oval"), depth=(0.62, 0.75), waist=(0.04, 0.09),
    ),
    "mustard": Recipe(
        (0.17, 0.20), (0.029, 0.033), (0.74, 0.80), (0.93, 0.95), "round", (0.80, 0.90), (0.018, 0.021),
        (0.020, 0.023), ("nozzle",), ("yellow plastic", "red plastic", "cream plastic", "brown plastic"),
        ("yellow", "red", "white", "black"), ("oval", "band"), ribs=(0, 3),
    ),
    "hot sauce": Recipe(
        (0.155, 0.185), (0.025, 0.028), (0.55, 0.62), (0.76, 0.81), "ogee", (0.84, 0.92), (0.0135, 0.015),
        (0.022, 0.027), ("fluted", "smooth"), ("chilli", "soy", "green sauce"), ("green", "red", "black", "gold"),
        ("diamond", "classic"), squareness=(0.0, 0.0),
    ),
    "shampoo": Recipe(
        (0.18, 0.23), (0.036, 0.041), (0.74, 0.84), (0.95, 0.97), "round", (0.88, 0.96), (0.017, 0.022),
        (0.028, 0.036), ("smooth", "dome"),
        ("mint plastic", "lilac plastic", "white plastic", "coral plastic", "teal plastic"),
        ("white", "silver", "gold", "black"), ("minimal", "oval"), depth=(0.55, 0.7), taper=(0.86, 1.0),
    ),
    "lotion": Recipe(
        (0.15, 0.19), (0.026, 0.031), (0.92, 0.94), (0.985, 0.99), "round", (0.85, 0.95), (0.019, 0.0235),
        (0.030, 0.038), ("smooth",),
        ("white plastic", "black plastic", "mint plastic", "blush plastic", "teal plastic"),
        ("silver", "gold", "white", "black", "copper"), ("minimal",), foot=(0.002, 0.004),
    ),
    "medicine": Recipe(
        (0.12, 0.145), (0.030, 0.036), (0.72, 0.78), (0.90, 0.93), "round", (0.86, 0.92), (0.019, 0.0235),
        (0.019, 0.024), ("fluted",), ("amber glass", "white plastic", "amber glass", "green plastic"),
        ("white", "white", "blue", "green"), ("pharmacy",), squareness=(0.0, 0.15),
    ),
    "syrup": Recipe(
        (0.15, 0.18), (0.030, 0.034), (0.66, 0.72), (0.84, 0.88), "round", (0.82, 0.90), (0.0145, 0.017),
        (0.020, 0.024), ("fluted",), ("amber glass", "brown glass"), ("white", "black", "red"), ("pharmacy",),
        depth=(0.6, 0.72), squareness=(0.1, 0.3),
    ),
    "thermos": Recipe(
        (0.23, 0.28), (0.034, 0.037), (0.86, 0.90), (0.96, 0.975), "round", (0.90, 0.96), (0.0225, 0.025),
        (0.032, 0.040), ("smooth", "beaker"), ("steel", "green steel", "navy steel", "red steel", "black steel"),
        ("steel", "black", "silver"), ("badge",), foot=(0.003, 0.005),
    ),
    "sports": Recipe(
        (0.20, 0.235), (0.035, 0.038), (0.80, 0.86), (0.95, 0.97), "round", (0.88, 0.95), (0.0225, 0.025),
        (0.019, 0.022), ("spout",), ("sky plastic", "lime plastic", "smoke plastic", "coral plastic", "white plastic"),
        ("black", "white", "orange", "navy", "lime"), ("wave", "badge"), waist=(0.10, 0.15), foot=(0.004, 0.007),
    ),
    "serum": Recipe(
        (0.135, 0.16), (0.0255, 0.029), (0.70, 0.76), (0.86, 0.90), "round", (0.82, 0.92), (0.0125, 0.0145),
        (0.020, 0.023), ("bulb",), ("amber glass", "blue glass", "frosted glass", "green glass"),
        ("black", "white", "gold", "silver"), ("minimal", "pharmacy"), foot=(0.002, 0.004),
    ),
    "oil": Recipe(
        (0.25, 0.29), (0.030, 0.034), (0.58, 0.64), (0.74, 0.80), "ogee", (0.86, 0.92), (0.0145, 0.0165),
        (0.026, 0.034), ("smooth", "long"), ("dark oil glass", "olive oil", "green glass"),
        ("black", "gold", "green", "copper"), ("estate", "diamond"), squareness=(0.75, 1.0),
    ),
}  # fmt: skip

NOVEL_RECIPES: dict[str, Recipe] = {
    "laboratory flask": Recipe(
        (0.15, 0.18), (0.046, 0.052), (0.08, 0.14), (0.74, 0.80), "cone", (0.86, 0.92), (0.0160, 0.0185),
        (0.026, 0.032), ("smooth", "dome"), ("frosted glass", "green sauce", "blue water"), ("blue", "red", "orange"),
        ("pharmacy", "minimal"),
    ),
    "decanter": Recipe(
        (0.19, 0.22), (0.044, 0.049), (0.30, 0.38), (0.78, 0.84), "cone", (0.84, 0.90), (0.0150, 0.0165),
        (0.024, 0.030), ("ball",), ("amber glass", "cola", "olive oil"), ("silver", "gold", "steel"), ("diamond",),
        squareness=(0.3, 0.9),
    ),
    "perfume": Recipe(
        (0.105, 0.125), (0.030, 0.036), (0.74, 0.82), (0.92, 0.95), "round", (0.82, 0.90), (0.0150, 0.0180),
        (0.022, 0.026), ("ball", "dome"), ("frosted glass", "blue glass", "berry drink", "straw glass"),
        ("gold", "copper", "black"), ("minimal",), depth=(0.46, 0.54), squareness=(0.6, 1.0),
    ),
    "preserve jar": Recipe(
        (0.105, 0.120), (0.036, 0.041), (0.78, 0.84), (0.93, 0.96), "round", (0.92, 0.97), (0.0246, 0.0256),
        (0.020, 0.024), ("fluted", "beaker"), ("chilli", "orange drink", "green sauce", "berry drink"),
        ("gold", "red", "white"), ("dairy", "oval"), ribs=(3, 4),
    ),
    "canteen": Recipe(
        (0.19, 0.22), (0.050, 0.056), (0.62, 0.68), (0.88, 0.92), "round", (0.84, 0.90), (0.0195, 0.0225),
        (0.024, 0.030), ("ball", "fluted"), ("green steel", "steel", "brown plastic"), ("black", "steel"),
        ("badge",), depth=(0.42, 0.5),
    ),
    "dumbbell": Recipe(
        (0.20, 0.235), (0.038, 0.043), (0.74, 0.80), (0.93, 0.95), "round", (0.84, 0.92), (0.0165, 0.019),
        (0.028, 0.034), ("dome", "smooth"), ("lime plastic", "coral plastic", "smoke plastic", "lilac plastic"),
        ("orange", "navy", "pink"), ("wave",), waist=(0.24, 0.30), foot=(0.008, 0.012),
    ),
    "bell": Recipe(
        (0.16, 0.19), (0.036, 0.041), (0.60, 0.68), (0.86, 0.90), "ogee", (0.84, 0.92), (0.0165, 0.0195),
        (0.026, 0.032), ("ball", "smooth"), ("teal plastic", "mint plastic", "blush plastic", "black plastic"),
        ("copper", "silver", "white"), ("oval", "minimal"), taper=(1.05, 1.07),
    ),
}  # fmt: skip
"""Kinds, shoulders and caps that no seen bottle has."""


@dataclass(frozen=True)
class Finish:
    """Look of a bottle's body: its wall and, if transparent, its content."""

    wall: Color
    content: Color | None = None
    roughness: float = 0.35
    metallic: float = 0.0


FINISHES: dict[str, Finish] = {
    "green glass": Finish((0.012, 0.055, 0.022), None, 0.12),
    "brown glass": Finish((0.055, 0.022, 0.008), None, 0.12),
    "straw glass": Finish((0.62, 0.58, 0.36), (0.50, 0.34, 0.07), 0.12),
    "blue glass": Finish((0.010, 0.035, 0.22), None, 0.12),
    "amber glass": Finish((0.28, 0.085, 0.010), None, 0.14),
    "frosted glass": Finish((0.62, 0.70, 0.68), (0.50, 0.58, 0.50), 0.6),
    "dark oil glass": Finish((0.018, 0.026, 0.008), None, 0.12),
    "olive oil": Finish((0.60, 0.62, 0.42), (0.42, 0.36, 0.02), 0.12),
    "cola": Finish((0.60, 0.62, 0.62), (0.045, 0.014, 0.008), 0.2),
    "orange drink": Finish((0.66, 0.64, 0.60), (0.80, 0.24, 0.01), 0.2),
    "lemon drink": Finish((0.62, 0.68, 0.58), (0.52, 0.62, 0.10), 0.2),
    "berry drink": Finish((0.64, 0.58, 0.62), (0.42, 0.02, 0.10), 0.2),
    "water": Finish((0.66, 0.76, 0.82), (0.46, 0.64, 0.76), 0.15),
    "blue water": Finish((0.34, 0.58, 0.80), (0.18, 0.42, 0.70), 0.15),
    "milk": Finish((0.70, 0.74, 0.74), (0.86, 0.85, 0.80), 0.2),
    "pale plastic": Finish((0.82, 0.83, 0.80), None, 0.5),
    "chilli": Finish((0.55, 0.50, 0.46), (0.52, 0.035, 0.01), 0.12),
    "soy": Finish((0.50, 0.44, 0.38), (0.030, 0.010, 0.005), 0.12),
    "green sauce": Finish((0.52, 0.56, 0.46), (0.12, 0.26, 0.02), 0.12),
    "red plastic": Finish((0.58, 0.018, 0.014), None, 0.35),
    "yellow plastic": Finish((0.85, 0.53, 0.02), None, 0.35),
    "cream plastic": Finish((0.82, 0.74, 0.54), None, 0.35),
    "brown plastic": Finish((0.10, 0.030, 0.012), None, 0.35),
    "mint plastic": Finish((0.36, 0.68, 0.54), None, 0.4),
    "lilac plastic": Finish((0.46, 0.34, 0.66), None, 0.4),
    "white plastic": Finish((0.84, 0.84, 0.82), None, 0.4),
    "black plastic": Finish((0.018, 0.018, 0.020), None, 0.4),
    "coral plastic": Finish((0.82, 0.20, 0.14), None, 0.4),
    "teal plastic": Finish((0.02, 0.26, 0.28), None, 0.4),
    "blush plastic": Finish((0.80, 0.50, 0.46), None, 0.4),
    "green plastic": Finish((0.05, 0.32, 0.14), None, 0.4),
    "sky plastic": Finish((0.16, 0.46, 0.74), None, 0.4),
    "lime plastic": Finish((0.42, 0.66, 0.05), None, 0.4),
    "smoke plastic": Finish((0.14, 0.15, 0.16), None, 0.4),
    "steel": Finish((0.62, 0.62, 0.63), None, 0.32, 0.9),
    "green steel": Finish((0.04, 0.16, 0.09), None, 0.45, 0.3),
    "navy steel": Finish((0.02, 0.05, 0.16), None, 0.45, 0.3),
    "red steel": Finish((0.42, 0.025, 0.025), None, 0.45, 0.3),
    "black steel": Finish((0.025, 0.025, 0.028), None, 0.5, 0.3),
}

CAP_LOOKS: dict[str, Material] = {
    "white": Material((0.86, 0.86, 0.84), 0.45),
    "black": Material((0.020, 0.020, 0.022), 0.45),
    "red": Material((0.62, 0.020, 0.018), 0.4),
    "claret": Material((0.16, 0.008, 0.020), 0.35, 0.3),
    "orange": Material((0.86, 0.25, 0.012), 0.4),
    "yellow": Material((0.88, 0.58, 0.02), 0.4),
    "green": Material((0.03, 0.30, 0.08), 0.4),
    "lime": Material((0.42, 0.66, 0.05), 0.4),
    "blue": Material((0.02, 0.12, 0.52), 0.4),
    "sky": Material((0.16, 0.46, 0.78), 0.4),
    "navy": Material((0.015, 0.03, 0.12), 0.4),
    "pink": Material((0.80, 0.22, 0.42), 0.4),
    "gold": Material((0.72, 0.50, 0.17), 0.28, 0.9),
    "silver": Material((0.72, 0.72, 0.73), 0.28, 0.9),
    "copper": Material((0.66, 0.32, 0.20), 0.3, 0.9),
    "steel": Material((0.60, 0.60, 0.61), 0.35, 0.9),
}

LABEL_PAPERS: tuple[Color, ...] = (
    (0.86, 0.84, 0.76), (0.88, 0.88, 0.87), (0.80, 0.72, 0.50), (0.10, 0.10, 0.11), (0.86, 0.62, 0.08),
    (0.55, 0.03, 0.04), (0.03, 0.16, 0.42), (0.06, 0.30, 0.16),
)  # fmt: skip
LABEL_INKS: tuple[Color, ...] = (
    (0.02, 0.02, 0.03), (0.55, 0.03, 0.03), (0.03, 0.14, 0.42), (0.06, 0.28, 0.12), (0.60, 0.42, 0.10),
    (0.86, 0.85, 0.80), (0.86, 0.40, 0.03), (0.42, 0.06, 0.30),
)  # fmt: skip
