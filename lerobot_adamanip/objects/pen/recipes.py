"""Kinds of pens and their stands: sizes of real products [m], and their colours."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot_adamanip.objects.base import Material

Range = tuple[float, float]


@dataclass(frozen=True)
class Recipe:
    """A kind of pen: sampled parameters and their ranges.

    Attributes:
        cap_radius, cap_length: radius and length of the cap.
        barrel_ratio: radius of the barrel, as a fraction of the cap's.
        exposed: visible length of the barrel, between stand and cap.
        ends: kinds of upper end.
        clips: kinds of clip.
        tip: kind of tip.
        barrels: names of `LOOKS`, for the barrel.
        caps: names of `LOOKS`, for the cap; empty for the barrel's.
        trims: names of `LOOKS`, for clip and rings; empty for the cap's.
        sides: number of sides of the barrel; 0 is round.
        depth: extent front to back as a fraction of the width.
        squareness: squareness of the cross section.
        ribbed: whether the cap has grooves along it.
        print: kind of print on the barrel.
    """

    cap_radius: Range
    cap_length: Range
    barrel_ratio: Range
    exposed: Range
    ends: tuple[str, ...]
    clips: tuple[str, ...]
    tip: str
    barrels: tuple[str, ...]
    caps: tuple[str, ...] = ()
    trims: tuple[str, ...] = ()
    sides: int = 0
    depth: Range = (1.0, 1.0)
    squareness: Range = (0.0, 0.0)
    ribbed: bool = False
    print: str = ""


_LACQUERS = ("black", "navy", "burgundy", "forest", "ivory", "teal", "tortoise")
_METALS = ("gold", "silver", "rose gold", "gunmetal")
_BRIGHT = ("red", "orange", "yellow", "green", "blue", "sky", "purple", "pink", "brown")
RECIPES: dict[str, Recipe] = {
    "fountain pen": Recipe(
        (0.0064, 0.0074), (0.056, 0.066), (0.90, 0.95), (0.050, 0.066), ("dome", "flat", "finial"),
        ("bar", "arrow", "ball"), "nib", _LACQUERS, (), ("gold", "silver", "rose gold"), print="rings",
    ),
    "rollerball": Recipe(
        (0.0062, 0.0068), (0.054, 0.062), (0.92, 0.97), (0.050, 0.066), ("flat", "cone"), ("bar", "arrow"), "ball",
        _METALS + _LACQUERS[:3], _METALS, _METALS, print="rings",
    ),
    "fineliner": Recipe(
        (0.0061, 0.0066), (0.046, 0.056), (0.92, 0.97), (0.062, 0.078), ("flat", "cone"), ("moulded",), "felt",
        ("grey", "yellow", "white", "black"), _BRIGHT, print="maker",
    ),
    "ballpoint": Recipe(
        (0.0061, 0.0064), (0.050, 0.058), (0.72, 0.78), (0.066, 0.080), ("cone",), ("moulded",), "ball",
        ("clear", "clear", "amber", "white"), ("blue", "black", "red", "green"), sides=6,
    ),
    "felt-tip pen": Recipe(
        (0.0064, 0.0074), (0.042, 0.050), (0.93, 0.97), (0.058, 0.072), ("dome", "flat"), ("moulded",), "felt",
        ("white", "white", "ivory"), _BRIGHT, ribbed=True, print="stripe",
    ),
    "permanent marker": Recipe(
        (0.0066, 0.0074), (0.050, 0.060), (0.98, 1.06), (0.050, 0.062), ("cone",), ("moulded",), "felt",
        ("grey", "white", "steel"), ("black", "red", "blue", "green"), print="maker",
    ),
    "whiteboard marker": Recipe(
        (0.0088, 0.0105), (0.042, 0.050), (0.94, 0.99), (0.056, 0.068), ("flat",), ("moulded",), "chisel",
        ("white",), ("black", "red", "blue", "green"), print="maker",
    ),
    "highlighter": Recipe(
        (0.0095, 0.0110), (0.042, 0.048), (0.98, 1.05), (0.046, 0.058), ("flat",), ("flat",), "chisel",
        ("neon yellow", "neon pink", "neon green", "neon orange", "neon blue"), (), ("black", ""),
        depth=(0.62, 0.78), squareness=(0.5, 0.9), print="maker",
    ),
    "brush pen": Recipe(
        (0.0062, 0.0070), (0.058, 0.068), (0.93, 0.98), (0.056, 0.070), ("flat", "dome"), ("bar", "moulded"), "brush",
        ("black", "burgundy", "forest", "navy"), (), ("gold", "silver", ""), print="column",
    ),
    "jumbo marker": Recipe(
        (0.0095, 0.0110), (0.040, 0.046), (0.96, 1.02), (0.052, 0.062), ("dome",), ("moulded",), "felt",
        _BRIGHT, (), ribbed=True, print="stripe",
    ),
}  # fmt: skip
NOVEL_RECIPES: dict[str, Recipe] = {
    "glue stick": Recipe(
        (0.0118, 0.0132), (0.034, 0.039), (0.98, 1.03), (0.040, 0.052), ("flat",), ("none",), "felt",
        ("white", "yellow", "orange"), ("blue", "red", "purple"), (), print="stripe",
    ),
    "lip gloss": Recipe(
        (0.0084, 0.0096), (0.034, 0.040), (0.90, 0.98), (0.042, 0.052), ("finial", "dome"), ("none",), "brush",
        ("pink", "burgundy", "clear"), ("gold", "rose gold", "black"), ("silver", "gold"),
    ),
    "three-sided pen": Recipe(
        (0.0076, 0.0088), (0.046, 0.054), (0.76, 0.84), (0.056, 0.068), ("cone", "dome"), ("none", "bar"), "ball",
        ("sky", "green", "orange", "purple"), ("white", "grey", "yellow"), ("silver",), sides=3,
    ),
    "paint marker": Recipe(
        (0.0112, 0.0124), (0.048, 0.056), (0.99, 1.04), (0.046, 0.058), ("cone", "finial"), ("arrow", "ball"),
        "chisel", ("steel", "gunmetal"), ("teal", "brown", "orange", "pink"), ("gunmetal",), print="rings",
    ),
    "flat pen": Recipe(
        (0.0100, 0.0112), (0.052, 0.060), (0.94, 0.99), (0.050, 0.062), ("flat",), ("none",), "nib",
        ("tortoise", "teal", "forest"), ("silver", "gold"), (), depth=(0.54, 0.60), squareness=(0.6, 1.0),
        print="column",
    ),
}  # fmt: skip
"""Novel kinds: thicker, flatter or three-sided, without a clip or with the clip of another kind."""


LOOKS: dict[str, Material] = {
    "black": Material((0.016, 0.016, 0.018), 0.25),
    "navy": Material((0.010, 0.022, 0.11), 0.22),
    "burgundy": Material((0.16, 0.010, 0.020), 0.22),
    "forest": Material((0.010, 0.075, 0.035), 0.22),
    "ivory": Material((0.80, 0.74, 0.58), 0.3),
    "teal": Material((0.008, 0.16, 0.17), 0.22),
    "tortoise": Material((0.20, 0.075, 0.018), 0.22),
    "gold": Material((0.74, 0.52, 0.18), 0.25, 0.9),
    "silver": Material((0.74, 0.74, 0.75), 0.25, 0.9),
    "rose gold": Material((0.72, 0.42, 0.32), 0.25, 0.9),
    "gunmetal": Material((0.20, 0.20, 0.22), 0.3, 0.85),
    "steel": Material((0.55, 0.55, 0.56), 0.4, 0.8),
    "grey": Material((0.30, 0.31, 0.32), 0.5),
    "white": Material((0.84, 0.84, 0.82), 0.4),
    "clear": Material((0.68, 0.74, 0.76), 0.15),
    "amber": Material((0.88, 0.42, 0.02), 0.3),
    "red": Material((0.64, 0.016, 0.016), 0.35),
    "orange": Material((0.88, 0.24, 0.010), 0.35),
    "yellow": Material((0.88, 0.62, 0.02), 0.35),
    "green": Material((0.02, 0.30, 0.07), 0.35),
    "blue": Material((0.012, 0.08, 0.48), 0.35),
    "sky": Material((0.10, 0.44, 0.78), 0.35),
    "purple": Material((0.19, 0.03, 0.40), 0.35),
    "pink": Material((0.82, 0.16, 0.36), 0.35),
    "brown": Material((0.16, 0.055, 0.020), 0.35),
    "neon yellow": Material((0.80, 0.90, 0.03), 0.4),
    "neon pink": Material((0.95, 0.12, 0.40), 0.4),
    "neon green": Material((0.18, 0.86, 0.14), 0.4),
    "neon orange": Material((0.98, 0.30, 0.02), 0.4),
    "neon blue": Material((0.06, 0.56, 0.90), 0.4),
}

WOODS = (
    Material((0.30, 0.15, 0.065), 0.55), Material((0.085, 0.036, 0.018), 0.45), Material((0.56, 0.38, 0.20), 0.6),
    Material((0.20, 0.065, 0.030), 0.45),
)  # fmt: skip
STONES = (
    Material((0.70, 0.69, 0.67), 0.25), Material((0.035, 0.038, 0.042), 0.2), Material((0.10, 0.22, 0.16), 0.2),
    Material((0.42, 0.40, 0.38), 0.8), Material((0.52, 0.30, 0.24), 0.3),
)  # fmt: skip
PLAINS = (
    Material((0.75, 0.80, 0.82), 0.12), Material((0.025, 0.026, 0.028), 0.5), Material((0.70, 0.70, 0.68), 0.5),
    Material((0.02, 0.16, 0.30), 0.5), Material((0.55, 0.10, 0.06), 0.5), Material((0.45, 0.55, 0.42), 0.6),
)  # fmt: skip
SOCKETS = ("gold", "silver", "gunmetal", "black")
STANDS = ("block", "slab", "disc", "cube", "ink stand", "column", "note tray")
NOVEL_STANDS = ("steps", "cone")
