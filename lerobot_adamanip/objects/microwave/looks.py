"""Appearance of microwaves: colours, control panels, door windows and handles. Only the handle collides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.geometry.rounded import plate
from lerobot_adamanip.objects.geometry.shapes import ball_bar, box, chamfered_box, dot, mark, rod

BLACK = Material((0.012, 0.012, 0.014), 0.35)
GLASS = Material((0.010, 0.011, 0.013), 0.12)
STEEL = Material((0.62, 0.62, 0.63), 0.34, 0.85)
CHROME = Material((0.80, 0.80, 0.81), 0.18, 0.95)
_CREAM, _WHITE, _GRAPHITE = (0.80, 0.74, 0.60), (0.80, 0.80, 0.79), (0.07, 0.072, 0.076)
_INKS = {"green": (0.10, 0.85, 0.35), "blue": (0.20, 0.62, 0.95), "amber": (0.95, 0.55, 0.08), "white": (0.9, 0.9, 0.9)}
_SEGMENTS = ["abcdef", "bc", "abged", "abgcd", "fgbc", "afgcd", "afgedc", "abc", "abcdefg", "abcdfg"]


def _paint(color: tuple[float, float, float], roughness: float = 0.45) -> Material:
    return Material(color, roughness, 0.0)


@dataclass(frozen=True)
class Look:
    """Materials and styles of one oven.

    Attributes:
        window: ``framed`` (a window in a painted door), ``glass`` (all glass), ``rounded`` (a retro
            window) or ``porthole``.
        controls: style of the panel: ``keypad``, ``dials``, ``touch`` or ``retro``.
        clock: four digits on the display.
    """

    name: str
    body: Material
    door: Material
    panel: Material
    handle: Material
    button: Material
    trim: Material
    window: str
    controls: str
    ink: str = "green"
    clock: str = "1200"

    def varied(self, rng: np.random.Generator) -> Look:
        """Returns the look with newly sampled shade and display and, where they fit, window and controls."""
        shade = rng.uniform(0.85, 1.12)
        controls, window = self.controls, self.window
        if self.controls in ("keypad", "dials", "touch") and rng.random() < 0.5:
            controls = str(rng.choice(("keypad", "dials", "touch")))
        if self.window == "framed" and rng.random() < 0.25:
            window = "rounded"
        clock = f"{rng.integers(1, 13):02d}{rng.integers(0, 60):02d}"
        ink = str(rng.choice(list(_INKS)))
        painted = replace(
            self, body=_shaded(self.body, shade), door=_shaded(self.door, shade), panel=_shaded(self.panel, shade)
        )
        return replace(painted, controls=controls, window=window, ink=ink, clock=clock)


def _shaded(material: Material, factor: float) -> Material:
    red, green, blue = (float(np.clip(value * factor, 0.01, 0.86)) for value in material.color)
    return replace(material, color=(red, green, blue))


def _plain(name: str, color: tuple[float, float, float], window: str, controls: str) -> Look:
    paint = _paint(color)
    pale = sum(color) > 1.2
    button = _paint((0.62, 0.63, 0.64)) if pale else _paint((0.35, 0.36, 0.37))
    handle = paint if pale else STEEL
    return Look(name, paint, paint, paint, handle, button, STEEL, window, controls)


def _retro(name: str, color: tuple[float, float, float]) -> Look:
    paint = _paint(color, 0.25)
    return Look(name, paint, paint, paint, CHROME, CHROME, CHROME, "rounded", "retro")


LOOKS = (
    _plain("white", _WHITE, "framed", "keypad"),
    _plain("white", _WHITE, "framed", "dials"),
    _plain("black", _GRAPHITE, "framed", "keypad"),
    _plain("anthracite", (0.16, 0.165, 0.17), "glass", "touch"),
    Look("stainless", STEEL, STEEL, BLACK, STEEL, STEEL, STEEL, "framed", "keypad"),
    Look("stainless", _paint(_GRAPHITE), STEEL, STEEL, CHROME, BLACK, CHROME, "framed", "dials"),
    Look("silver and glass", _paint((0.52, 0.53, 0.54)), GLASS, GLASS, STEEL, STEEL, STEEL, "glass", "touch"),
    Look("white and glass", _paint(_WHITE), GLASS, _paint(_WHITE), STEEL, STEEL, STEEL, "glass", "keypad"),
    _plain("red", (0.42, 0.025, 0.03), "framed", "keypad"),
    _retro("cream", _CREAM),
    _retro("mint", (0.38, 0.66, 0.55)),
    _retro("sky", (0.30, 0.50, 0.66)),
    _retro("cherry", (0.50, 0.03, 0.04)),
)


@dataclass(frozen=True)
class Face:
    """Area for controls: centre y, lower and upper edge z, and width [m]; the face is x = 0."""

    y: float
    low: float
    high: float
    width: float


def panel_shapes(look: Look, face: Face) -> tuple[Shape, ...]:
    """Returns the controls on the panel above the button, from top to bottom."""
    pale = sum(look.panel.color) > 0.9
    display_z = face.high - 0.030
    half_w = 0.5 * face.width - 0.016
    if look.controls == "dials":
        room = face.high - face.low
        radius = min(0.026, 0.2 * room, 0.5 * half_w + 0.012)
        centers = (face.low + 0.25 * room, face.low + 0.72 * room)
        return tuple(shape for z in centers for shape in _dial(look, face.y, z, radius, pale))
    screen = plate((0.0005, face.y, display_z), (0.001, half_w, 0.013), 0.003, GLASS, collides=False)
    shapes = [screen, *_clock(look, face.y, display_z)]
    top = display_z - 0.024
    if look.controls == "retro":
        radius = min(0.030, 0.42 * (top - face.low), half_w - 0.006)
        return (*shapes, *_dial(look, face.y, (top + face.low) / 2, radius, pale))
    if look.controls == "touch":
        glass = plate(
            (0.0, face.y, (face.low + face.high) / 2),
            (0.0009, half_w + 0.008, (face.high - face.low) / 2 - 0.004),
            0.004,
            GLASS,
            collides=False,
        )
        return (glass, *shapes, *_keys(face, top, _paint((0.50, 0.52, 0.54)), 0.0016, 0.45))
    key = _paint((0.30, 0.31, 0.32)) if pale else _paint((0.52, 0.53, 0.54))
    return (*shapes, *_keys(face, top, key, 0.0028, 1.0))


def _keys(face: Face, top: float, material: Material, proud: float, scale: float) -> tuple[Shape, ...]:
    """Returns rows of three keys, and one long green key below."""
    half_w = 0.5 * face.width - 0.016
    rows = int(np.clip((top - face.low) // 0.0165, 2, 6))
    step_z, step_y = (top - face.low) / rows, 2 * half_w / 3
    keys = []
    for row in range(rows - 1):
        for column in range(3):
            at = (0.0, face.y + (column - 1) * step_y, top - (row + 0.5) * step_z)
            half = (proud, scale * 0.40 * step_y, scale * 0.32 * step_z)
            keys.append(plate(at, half, 0.0025, material, collides=False))
    at, half = (0.0, face.y, top - (rows - 0.5) * step_z), (proud, 0.9 * half_w, scale * 0.32 * step_z)
    return (*keys, plate(at, half, 0.0025, _paint((0.05, 0.38, 0.16)), collides=False))


def _clock(look: Look, y: float, z: float) -> tuple[Shape, ...]:
    """Returns four seven-segment digits with a colon, readable from the front."""
    ink = Material(_INKS[look.ink], 0.4)
    half_w, half_h, line = 0.0032, 0.0060, 0.0009
    spots = {
        "a": (0, half_h, True), "g": (0, 0, True), "d": (0, -half_h, True), "b": (half_w, half_h / 2, False),
        "c": (half_w, -half_h / 2, False), "f": (-half_w, half_h / 2, False), "e": (-half_w, -half_h / 2, False),
    }  # fmt: skip
    shapes = []
    for digit, offset in zip(look.clock, (-0.0185, -0.0075, 0.0075, 0.0185), strict=True):
        for segment in _SEGMENTS[int(digit)]:
            dy, dz, lies = spots[segment]
            half = (0.0004, half_w if lies else line, line if lies else half_h / 2)
            shapes.append(mark((0.0018, y + offset + dy, z + dz), half, ink))
    dots = [mark((0.0018, y, z + dz), (0.0004, 0.0011, 0.0011), ink) for dz in (-0.003, 0.003)]
    return (*shapes, *dots)


def _dial(look: Look, y: float, z: float, radius: float, pale: bool) -> tuple[Shape, ...]:
    """Returns a rotary dial with a scale around it, as a static print on the body."""
    ink = _paint((0.05, 0.05, 0.055)) if pale else _paint((0.75, 0.75, 0.74))
    cap = look.trim if look.controls == "retro" or not pale else _paint((0.68, 0.69, 0.70))
    shapes = [
        dot((0.002, y, z), radius * 0.84, 0.002, look.trim),
        dot((0.009, y, z), radius * 0.74, 0.009, cap),
        mark((0.0185, y, z + 0.36 * radius), (0.0008, 0.0013, 0.3 * radius), BLACK),
    ]
    for angle in np.linspace(-2.2, 2.2, 11):
        at = (0.0005, y + 1.06 * radius * np.sin(angle), z + 1.06 * radius * np.cos(angle))
        shapes.append(dot(at, 0.0013, 0.0005, ink))
    return tuple(shapes)


def door_front(look: Look, middle: float, half: tuple[float, float], free: float, free_side: int) -> tuple[Shape, ...]:
    """Returns window, mesh, frame and name plate of a door with front x = 0, in the door frame (origin at the hinge).

    Args:
        look: look of the oven.
        middle: y of the door's middle [m].
        half: half extents (y, z) of the door [m].
        free: width of the handle's strip at the free edge [m].
        free_side: sign of y at the free edge.
    """
    rim, (half_w, half_h) = 0.030, half
    y = middle - free_side * (free - rim) / 2
    win_w, win_h = half_w - (free + rim) / 2, half_h - (0.040 if look.window != "glass" else 0.034)
    if look.window == "porthole":
        win_w = win_h = min(win_w, win_h)
    radius = {"framed": 0.006, "glass": 0.004, "rounded": 0.045, "porthole": 0.99 * win_h}[look.window]
    pane = Material((0.022, 0.023, 0.026), 0.15) if look.window == "glass" else GLASS
    shapes = [plate((0.0, y, 0.006), (0.0012, win_w, win_h), radius, pane, collides=False)]
    if look.window != "glass":
        frame = look.trim if look.window in ("rounded", "porthole") else _shaded(look.door, 0.72)
        around = plate((0.0, y, 0.006), (0.0008, win_w + 0.006, win_h + 0.006), radius + 0.006, frame, collides=False)
        shapes.insert(0, around)
    shapes += _mesh(y, win_w - 0.010, win_h - 0.010, max(0.0, radius - 0.01))
    plate_z = -half_h + (0.016 if look.window != "glass" else 0.014)
    shapes.append(mark((0.0006, y, plate_z), (0.0008, 0.018, 0.0032), look.trim))
    return tuple(shapes)


def _mesh(y: float, half_w: float, half_h: float, radius: float) -> list[Shape]:
    """Returns the shielding mesh: fine lines behind the glass, shortened at round corners."""
    line = Material((0.05, 0.052, 0.055), 0.6)
    shapes = []
    for v in np.linspace(-1, 1, max(5, int(half_h / 0.0054)) | 1):
        short = _corner(abs(v) * half_h, half_h, radius)
        shapes.append(mark((0.0012, y, 0.006 + v * half_h), (0.0003, half_w - short, 0.0008), line))
    for u in np.linspace(-1, 1, max(7, int(half_w / 0.0054)) | 1):
        short = _corner(abs(u) * half_w, half_w, radius)
        shapes.append(mark((0.0012, y + u * half_w, 0.006), (0.0003, 0.0008, half_h - short), line))
    return shapes


def _corner(along: float, half: float, radius: float) -> float:
    """Returns the length that a round corner removes from a line ``along`` [m] from the middle."""
    into = along - (half - radius)
    return 0.0 if into <= 0 else radius - float(np.sqrt(max(radius**2 - into**2, 0.0)))


def handle_shapes(
    style: str, grip: tuple[float, float, float], length: float, radius: float, material: Material
) -> tuple[Shape, ...]:
    """Returns an upright handle at a distance from the door; all shapes collide.

    Args:
        style: ``round bar``, ``flat bar``, ``bow``, ``pull``, ``fin`` or ``ball bar``.
        grip: (3,) centre of the handle, in the door frame [m].
        length: length of the handle [m].
        radius: half its thickness [m].
        material: look of the handle.
    """
    x, y, z = grip
    half = length / 2
    if style == "flat bar":
        bar = chamfered_box((x, y, z), (0.6 * radius, radius, half), 0.002, material)
        posts = [
            box((x / 2, y, z + s * (half - 0.012)), (x / 2, 0.75 * radius, 0.75 * radius), material) for s in (-1, 1)
        ]
        return (bar, *posts)
    if style == "fin":
        return (chamfered_box((x / 2, y, z), (x / 2 + 0.008, radius, half), 0.003, material),)
    if style == "ball bar":
        return ball_bar(grip, half, (radius, 1.5 * radius, 0.75 * radius), material)
    if style == "pull":
        bar = plate((x, y, z), (0.010, radius, half), radius, material, bevel=0.003)
        posts = [box((x / 2, y, z + s * (half - 0.020)), (x / 2, radius, 0.018), material) for s in (-1, 1)]
        return (bar, *posts)
    if style == "bow":
        return _bow(grip, half, radius, material)
    ends = [np.array([x, y, z + s * half]) for s in (-1, 1)]
    posts = [
        rod((0.0, y, z + s * (half - 0.014)), (x, y, z + s * (half - 0.014)), 0.7 * radius, material) for s in (-1, 1)
    ]
    return (rod(ends[0], ends[1], radius, material, round_ends=False), *posts)


def _bow(grip: tuple[float, float, float], half: float, radius: float, material: Material) -> tuple[Shape, ...]:
    x, y, z = grip
    roots = [np.array([0.0, y, z + s * half]) for s in (-1, 1)]
    ends = [np.array([x, y, z + s * 0.5 * half]) for s in (-1, 1)]
    knees = [np.array([0.78 * x, y, z + s * 0.8 * half]) for s in (-1, 1)]
    arms = [rod(a, b, radius, material) for i in (0, 1) for a, b in ((roots[i], knees[i]), (knees[i], ends[i]))]
    return (rod(ends[0], ends[1], radius, material), *arms)
