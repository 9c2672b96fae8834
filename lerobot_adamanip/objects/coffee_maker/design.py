"""The parameters of a coffee maker, and how they are drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import Material
from lerobot_adamanip.objects.drawing import chosen, computed, draw, either_side, picked, uniform

BODY_STYLES = ("box", "column", "rounded")
PANEL_STYLES = ("gauge", "buttons", "dial", "display")
TOP_STYLES = ("cups", "rail", "hopper", "plain")
HANDLE_STYLES = ("tapered", "straight", "waisted")
SPOUT_STYLES = ("double", "single", "bottomless")

BLACK = Material((0.022, 0.022, 0.025), 0.5)
_BODY_COLORS = (
    Material((0.70, 0.71, 0.73), 0.25, 0.95), Material((0.58, 0.59, 0.61), 0.38, 0.95),
    Material((0.035, 0.036, 0.04), 0.4, 0.2), Material((0.50, 0.02, 0.025), 0.28, 0.1),
    Material((0.72, 0.66, 0.52), 0.35), Material((0.36, 0.58, 0.52), 0.35), Material((0.78, 0.78, 0.77), 0.35),
    Material((0.06, 0.12, 0.24), 0.3, 0.1), Material((0.12, 0.125, 0.13), 0.45, 0.4),
)  # fmt: skip
_GRIPS = (
    Material((0.02, 0.02, 0.022), 0.45), Material((0.02, 0.02, 0.022), 0.45), Material((0.23, 0.10, 0.035), 0.5),
    Material((0.38, 0.22, 0.10), 0.5), Material((0.70, 0.66, 0.55), 0.4),
)  # fmt: skip

NOVEL_PANEL_STYLES = ("twin gauge", "slot")
NOVEL_COLORS = ((0.72, 0.30, 0.04), (0.30, 0.05, 0.20), (0.10, 0.28, 0.10), (0.72, 0.54, 0.10), (0.20, 0.36, 0.56))


@dataclass(frozen=True, kw_only=True)
class CoffeeMakerDesign:
    """The parameters of one machine [m]. ``x`` values are measured from the group's axis, forwards.
    Nothing but group and tray comes farther forward than that axis.

    Attributes:
        tray_height: of the base with the drip tray.
        group_z: height of the group head's lower face.
        axis_x: where the group's axis is, behind the tray's front.
        head_x: front face of the upper housing.
        column_x: front face of the back wall behind the cups.
        grip_radius: of the grip, from the axis.
        handle_length: from the axis to the handle's end.
        handle_half: half width and height of the handle.
    """

    body_style: str = chosen(BODY_STYLES)
    tray_height: float = uniform(0.045, 0.062)
    group_z: float = computed(lambda rng, d: d.tray_height + rng.uniform(0.145, 0.165))
    grip_radius: float = uniform(0.155, 0.175)
    body: Material = picked(_BODY_COLORS)
    base: Material = computed(lambda rng, d: BLACK if rng.random() < 0.5 else d.body)
    width: float = uniform(0.20, 0.30)
    height: float = computed(lambda rng, d: d.group_z + rng.uniform(0.115, 0.155))
    depth: float = uniform(0.25, 0.33)
    axis_x: float = computed(lambda rng, d: -rng.uniform(0.055, 0.070))
    head_x: float = computed(
        lambda rng, d: -rng.uniform(*((0.058, 0.068) if d.body_style == "box" else (0.022, 0.034)))
    )
    column_x: float = computed(lambda rng, d: -rng.uniform(0.066, 0.078))
    handle_length: float = computed(lambda rng, d: d.grip_radius + rng.uniform(0.040, 0.052))
    handle_half: tuple[float, float] = computed(lambda rng, d: (rng.uniform(0.012, 0.015), rng.uniform(0.012, 0.0145)))
    wand_side: int = either_side()
    panel_style: str = chosen(PANEL_STYLES)
    top_style: str = chosen(TOP_STYLES)
    handle_style: str = chosen(HANDLE_STYLES)
    spout_style: str = chosen(SPOUT_STYLES)
    chrome: Material = computed(lambda rng, d: Material((0.80, 0.81, 0.83), rng.uniform(0.12, 0.25), 0.95))
    grip: Material = picked(_GRIPS)

    @property
    def head_face(self) -> float:
        """The upper housing's front in the object's frame [m]."""
        return self.axis_x + self.head_x


def draw_novel_design(rng: np.random.Generator) -> CoffeeMakerDesign:
    """Draws a machine slimmer, or wider and lower, than any seen one, in new styles all over."""
    base = draw(CoffeeMakerDesign, rng)
    slim = rng.random() < 0.5
    body = Material(NOVEL_COLORS[rng.integers(len(NOVEL_COLORS))], rng.uniform(0.25, 0.45), 0.1)
    return replace(
        base,
        width=rng.uniform(0.175, 0.195) if slim else rng.uniform(0.31, 0.345),
        height=base.group_z + (rng.uniform(0.16, 0.19) if slim else rng.uniform(0.105, 0.114)),
        depth=rng.uniform(0.335, 0.36) if slim else rng.uniform(0.23, 0.248),
        head_x=-rng.uniform(0.022, 0.034),
        body_style="slim" if slim else "barrel",
        panel_style=str(rng.choice(NOVEL_PANEL_STYLES)),
        top_style="boiler",
        handle_style="ball end",
        body=body,
        base=BLACK if rng.random() < 0.5 else body,
    )
