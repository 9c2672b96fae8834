"""Handles that turn on a leaf: levers, knobs and bars, and the plates they sit on. Shared by doors and windows.

A handle is built hanging down from its pivot, then rotated about x to its rest position. Frame: origin at the pivot on
the leaf's face, x out of the leaf, z up. Sizes follow door and window hardware. Levers stand 55 to 65 mm off the leaf
and are 96 to 124 mm long; knobs measure 45 to 56 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import rotation_about
from lerobot_adamanip.objects.base import TWO_FINGERS, Joint, Link, Material, Shape, any_roll
from lerobot_adamanip.objects.geometry.shapes import chamfered_box, convex_mesh, dot, mark, prism, rod, rotated

LEVERS = ("round lever", "return lever", "flat lever", "tapered lever", "swept lever", "paddle lever", "ball lever")
KNOBS = ("ball knob", "drum knob", "tulip knob", "octagon knob")
CENTRED = ("T bar", "olive", "cross bar")
PLATES = ("round rose", "square rose", "long plate")
METALS = (
    Material((0.76, 0.76, 0.77), 0.28, 0.9), Material((0.74, 0.56, 0.22), 0.28, 0.9),
    Material((0.34, 0.25, 0.17), 0.45, 0.8), Material((0.05, 0.05, 0.055), 0.5, 0.2),
)  # fmt: skip
DARK = Material((0.02, 0.02, 0.02), 0.7)
MASS = 0.06
"""Mass of the turning part [kg]."""
SPRING, KNOB_SPRING = 0.35, 0.06
"""Stiffness of the return spring [N m/rad]: for levers, and for handles gripped on their axis."""
SIDES = 32
"""Number of sides of round handles: a multiple of eight, so that each grasp of `any_roll` meets a flat face."""


@dataclass(frozen=True)
class HandleDesign:
    """Parameters of one handle [m, rad].

    Attributes:
        style: one of `LEVERS`, `KNOBS`, `CENTRED`.
        standoff: distance of the grip from the leaf's face.
        length: distance from a lever's pivot to its end, or full length of a bar.
        grip: distance of the grip from the pivot along the lever; 0 for a grip on the pivot.
        thickness: width between the fingers.
        rest: rotation about the leaf's outward normal, from hanging straight down to the rest position [rad].
        plate: one of `PLATES`.
        metal: material.
    """

    style: str
    standoff: float
    length: float
    grip: float
    thickness: float
    rest: float
    plate: str
    metal: Material

    @property
    def rolls(self) -> tuple[float, ...]:
        """Equivalent rolls of a grasp [rad]."""
        return any_roll() if self.style in KNOBS else TWO_FINGERS

    def grip_offset(self) -> NDArray[np.float64]:
        """Returns the position (3,) of the grip relative to the pivot: x out of the leaf, z up [m]."""
        sideways = _SWEEP if self.style == "swept lever" else 0.0
        return rotation_about((1.0, 0.0, 0.0), self.rest) @ (self.standoff - DEEPER, sideways, -self.grip)


DEEPER = 0.003
"""Depth of the pads behind the middle of the grip [m]: every failed pull slips a little."""
_SWEEP = 0.010
"""Sideways bow of a swept lever [m]."""


def draw_handle(
    rng: np.random.Generator, styles: Sequence[str], rest: float, metals: Sequence[Material]
) -> HandleDesign:
    """Samples a handle with one of ``styles``; knobs and bars ignore ``rest`` [rad]."""
    style = str(rng.choice(list(styles)))
    lever = style in LEVERS
    thickness = {"round lever": (0.017, 0.021), "return lever": (0.017, 0.021), "swept lever": (0.017, 0.021)}.get(
        style, (0.044, 0.056) if style in KNOBS else (0.014, 0.018)
    )
    if style == "olive":
        thickness = (0.024, 0.030)
    grip = rng.uniform(0.064, 0.076) if lever else 0.0
    return HandleDesign(
        style=style,
        standoff=rng.uniform(0.056, 0.063),
        length=grip + rng.uniform(0.032, 0.048) if lever else rng.uniform(0.085, 0.115),
        grip=grip,
        thickness=rng.uniform(*thickness),
        rest=rest if lever else 0.0,
        plate=str(rng.choice(PLATES)),
        metal=metals[int(rng.integers(len(metals)))],
    )


def handle_shapes(design: HandleDesign) -> tuple[Shape, ...]:
    """Returns the turning shapes, in the frame of the pivot."""
    if design.style in KNOBS:
        shapes = _knob(design)
    elif design.style in CENTRED:
        shapes = _centred(design)
    else:
        shapes = _lever(design)
    return rotated(shapes, (1.0, 0.0, 0.0), design.rest)


def handle_link(
    design: HandleDesign, names: tuple[str, str, str], pivot: NDArray[np.float64], turn_range: float, damping: float
) -> Link:
    """Returns the handle on its spindle. Positive is clockwise, seen from the front: about -x.

    A return spring, as in a lock case, brings it back to rest. Its tension balances the handle's weight: otherwise a
    sideways handle would sag in its turning direction and reveal the hidden state.

    Args:
        design: design of the handle.
        names: names of link, parent link and joint.
        pivot: (3,) in the parent's frame [m].
        turn_range: range to either side [rad].
        damping: damping of the spindle [N m s/rad].
    """
    link, parent, name = names
    shapes = handle_shapes(design)
    spring = SPRING if design.style in LEVERS else KNOB_SPRING
    tension = -MASS * 9.81 * _sideways(shapes) / spring
    x, y, z = (float(value) for value in pivot)
    axis, limits = (-1.0, 0.0, 0.0), (-turn_range, turn_range)
    joint = Joint(name, "revolute", axis, (x, y, z), limits, damping=damping, stiffness=spring, rest=tension)
    return Link(link, shapes, mass=MASS, parent=parent, joint=joint)


def _sideways(shapes: Sequence[Shape]) -> float:
    """Returns the offset (y) [m] of a handle's centre of mass from its spindle.

    Computed as bodies are built: middle of a box around mesh vertices, and around 2 cm beside all shapes' centres.
    """
    reach = []
    for shape in shapes:
        if shape.collides:
            reach += [shape.pose_in_link[1, 3] - 0.02, shape.pose_in_link[1, 3] + 0.02]
            if shape.vertices is not None:
                reach += list(shape.vertices @ shape.pose_in_link[1, :3] + shape.pose_in_link[1, 3])
    return float(max(reach) + min(reach)) / 2


def _lever(design: HandleDesign) -> list[Shape]:
    x, end, half, metal = design.standoff, -design.length, design.thickness / 2, design.metal
    neck = rod((0.004, 0, 0), (x, 0, 0), 0.0085, metal, round_ends=False)
    if design.style == "flat lever":
        middle = (end + half) / 2
        return [neck, chamfered_box((x, 0, middle), (0.010, half, half - middle), 0.002, metal)]
    if design.style == "paddle lever":
        # Two pieces: in one convex hull the gripped sides would form a wedge, and a pull would slip along it.
        hub = chamfered_box((x, 0, -0.006), (0.010, 1.7 * half, 0.018), 0.004, metal)
        return [neck, hub, chamfered_box((x, 0, end / 2), (0.010, half, -end / 2), 0.002, metal)]
    if design.style == "ball lever":
        ball = rod((x, 0, end), (x, 0, end + 0.0005), 1.5 * half, metal)
        hub = rod((x, 0, 0), (x, 0, 0.0005), 1.45 * half, metal)
        return [neck, rod((x, 0, 0.006), (x, 0, end), half, metal), hub, ball]
    if design.style == "tapered lever":
        return [rod((0.004, 0, 0), (x, 0, 0), 0.010, metal, round_ends=False), _tapered(x, end, half, metal)]
    if design.style == "swept lever":
        turn, back = -design.grip + 0.022, -design.grip - 0.020
        points = [(x, 0, 0), (x, _SWEEP, turn), (x, _SWEEP, back), (x, 0.3 * _SWEEP, end)]
        return [neck] + [rod(a, b, half, metal) for a, b in pairwise(points)]
    shapes = [neck, rod((x, 0, 0), (x, 0, end), half, metal)]
    if design.style == "return lever":
        shapes.append(rod((x, 0, end), (0.022, 0, end), half, metal))
    return shapes


def _tapered(x: float, end: float, half: float, metal: Material) -> Shape:
    """Returns a blade that is wide at the pivot and narrow at its end, at least ``half`` to each side."""
    ring = []
    for z, y, depth in ((0.013, half + 0.001, 0.007), (0.010, half + 0.004, 0.011), (end, half, 0.009)):
        ring += [(x + sx * depth, sy * y, z) for sx in (-1, 1) for sy in (-0.72, 0.72)]
        ring += [(x + sx * 0.6 * depth, sy * y, z) for sx in (-1, 1) for sy in (-1, 1)]
    return convex_mesh(np.asarray(ring, dtype=np.float64), np.eye(4), metal)


def _knob(design: HandleDesign) -> list[Shape]:
    """Returns a neck, and a turned head that is widest at the pads."""
    x, radius = design.standoff, design.thickness / 2
    if design.style == "octagon knob":
        shank = rod((0.002, 0, 0), (x - 0.012, 0, 0), 0.5 * radius, design.metal, round_ends=False)
        return [shank, prism((x, 0, 0), 0.98 * radius, 0.018, 8, design.metal, top=0.96)]
    profiles = {
        "ball knob": ((-0.026, 0.45), (-0.021, 0.72), (-0.014, 0.92), (-0.006, 1.0), (0.006, 1.0), (0.014, 0.92),
                      (0.021, 0.70), (0.026, 0.36)),
        "drum knob": ((-0.018, 0.86), (-0.014, 1.0), (0.014, 1.0), (0.018, 0.90)),
        "tulip knob": ((-0.034, 0.42), (-0.018, 0.80), (-0.008, 1.0), (0.008, 1.0), (0.014, 0.93), (0.018, 0.66)),
    }  # fmt: skip
    head = lathe([(x + along, radius * share) for along, share in profiles[design.style]], design.metal)
    shapes = [rod((0.002, 0, 0), (x - 0.012, 0, 0), 0.42 * radius, design.metal, round_ends=False), head]
    shapes.append(dot((x + 0.0185, 0, 0), 0.24 * radius, 0.008, design.metal))
    return shapes


def lathe(profile: Sequence[tuple[float, float]], material: Material) -> Shape:
    """Returns the convex hull of rings (x, radius) [m] about the x axis."""
    angles = (np.arange(SIDES) + 0.5) * 2 * np.pi / SIDES
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1) / np.cos(np.pi / SIDES)
    rings = [np.column_stack([np.full(SIDES, x), radius * around]) for x, radius in profile]
    return convex_mesh(np.concatenate(rings), np.eye(4), material)


def _centred(design: HandleDesign) -> list[Shape]:
    """Returns a bar across the pivot, or an oval knob; both are gripped on the axis by two flat sides."""
    x, half, metal = design.standoff, design.thickness / 2, design.metal
    neck = rod((0.004, 0, 0), (x, 0, 0), 0.010, metal, round_ends=False)
    if design.style == "cross bar":
        arms = ((0.011, half, design.length / 2), (0.011, 0.027, half))
        return [neck, *(chamfered_box((x, 0, 0), arm, 0.003, metal) for arm in arms)]
    if design.style == "T bar":
        return [neck, chamfered_box((x, 0, 0), (0.013, half, design.length / 2), 0.003, metal)]
    points = [
        (x + 0.016 * np.cos(t), s * (half if abs(np.sin(t)) < 0.6 else 0.82 * half), 0.030 * np.sin(t))
        for t in np.linspace(0, 2 * np.pi, 24, endpoint=False)
        for s in (-1, 1)
    ]
    points += [(x + 0.022 * np.cos(t), 0, 0.038 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 24, endpoint=False)]
    return [neck, convex_mesh(np.asarray(points, dtype=np.float64), np.eye(4), metal)]


def plate_shapes(
    design: HandleDesign, y: float, z: float, *, half_width: float, half_length: float, keyhole: bool
) -> tuple[Shape, ...]:
    """Returns the handle's plate at (y, z) of the leaf: a rose or a long plate; decoration, a few millimetres thick.

    Args:
        design: design of the handle.
        y: pivot in the leaf's frame [m].
        z: pivot in the leaf's frame [m].
        half_width: half width of a long plate, or radius of a rose [m].
        half_length: half length of a long plate [m].
        keyhole: whether there is a lock below the pivot.
    """
    metal, below = design.metal, z - 0.072
    if design.plate == "long plate":
        middle = z - (0.3 * half_length if keyhole else 0.0)
        shapes = [chamfered_box((0.0025, y, middle), (0.0035, half_width, half_length), 0.002, metal, collides=False)]
    elif design.plate == "square rose":
        shapes = [chamfered_box((0.003, y, z), (0.004, half_width, half_width), 0.002, metal, collides=False)]
    else:
        shapes = [dot((0.003, y, z), 1.05 * half_width, 0.004, metal)]
    shapes.append(dot((0.006, y, z), 0.62 * half_width, 0.006, metal))
    if keyhole:
        if design.plate != "long plate":
            shapes.append(dot((0.0025, y, below), 0.8 * half_width, 0.003, metal))
        shapes.append(dot((0.004, y, below), 0.0075, 0.0035, METALS[0]))
        shapes.append(mark((0.0068, y, below - 0.002), (0.001, 0.0013, 0.0045), DARK))
    return tuple(shapes)
