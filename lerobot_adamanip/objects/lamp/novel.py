"""Novel lamps: pagodas, stacked globes, candles and tulips on stepped bases, with switches of sixteen sides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.objects.base import Material, Shape
from lerobot_adamanip.objects.drawing import draw
from lerobot_adamanip.objects.geometry.rounded import revolved
from lerobot_adamanip.objects.geometry.shapes import rod
from lerobot_adamanip.objects.lamp.generator import LampDesign
from lerobot_adamanip.objects.lamp.heads import HAND_CLEARANCE, METALS, Head, Place

RADII = {"pagoda": (0.060, 0.072), "stack": (0.046, 0.056), "candle": (0.046, 0.056), "tulip": (0.050, 0.062)}
_GLOW, _OPAL = Material((0.92, 0.74, 0.30), 0.4), Material((0.86, 0.82, 0.70), 0.35)
_COLORS = ((0.66, 0.28, 0.06), (0.30, 0.08, 0.30), (0.60, 0.58, 0.12), (0.02, 0.32, 0.30), (0.72, 0.36, 0.42))


@dataclass(frozen=True)
class NovelHead(Head):
    """A head in one of the styles of `RADII`."""

    def shapes(self, place: Place) -> tuple[Shape, ...]:
        """Builds the head on a base, straight above the stem's foot."""
        build = {"pagoda": self._pagoda, "stack": self._stack, "candle": self._candle, "tulip": self._tulip}
        return build[self.style](place)

    def _stem(self, place: Place, up: float) -> tuple[Shape, ...]:
        collar = revolved(place.at(0, 0, 0), ((0.030, 0), (0.024, 0.006), (self.stem + 0.003, 0.020)), self.metal)
        return (collar, rod(place.at(0, 0, 0), place.at(0, 0, up), self.stem, self.metal, round_ends=False))

    def _pagoda(self, place: Place) -> tuple[Shape, ...]:
        """Returns three roofs, one above the other, each with a light."""
        shapes = list(self._stem(place, self.height))
        for level, share in ((0.50, 1.0), (0.68, 0.82), (0.86, 0.64)):
            low, r = level * self.height, share * self.radius
            roof = ((r, 0.0), (0.96 * r, 0.006), (0.34 * r, 0.036), (0.22 * r, 0.040))
            shapes.append(revolved(place.at(0, 0, low), roof, self.shade, sides=40))
            shapes.append(revolved(place.at(0, 0, low - 0.012), ((0.4 * r, 0.0), (0.4 * r, 0.012)), _OPAL))
        return tuple(shapes)

    def _stack(self, place: Place) -> tuple[Shape, ...]:
        """Returns three globes, each smaller than the one below."""
        shapes, up = list(self._stem(place, 0.36 * self.height)), 0.36 * self.height
        for share in (1.0, 0.78, 0.56):
            r = share * self.radius
            middle = place.at(0, 0, up + 0.96 * r)
            shapes.append(rod(middle, middle + np.array([0.0, 0.0, 1e-3]), r, _OPAL if share != 0.78 else self.shade))
            up += 1.84 * r
        return tuple(shapes)

    def _candle(self, place: Place) -> tuple[Shape, ...]:
        """Returns a thick candle in a dish, with its flame."""
        dish_radius, up = self.radius, 0.30 * self.height
        r, outline = 0.53 * dish_radius, ((0.2 * dish_radius, 0.0), (dish_radius, 0.012), (dish_radius, 0.016))
        dish = revolved(place.at(0, 0, up), outline, self.metal)
        wax = revolved(place.at(0, 0, up + 0.014), ((r, 0.0), (r, 0.12), (0.9 * r, 0.124)), self.shade)
        flame = ((0.003, 0.0), (0.010, 0.012), (0.009, 0.022), (0.002, 0.042))
        return (*self._stem(place, up), dish, wax, revolved(place.at(0, 0, up + 0.142), flame, _GLOW))

    def _tulip(self, place: Place) -> tuple[Shape, ...]:
        """Returns a cup that opens upwards, with a globe in it."""
        r, up = self.radius, self.height - 0.13
        cup = ((0.014, 0.0), (0.66 * r, 0.022), (0.92 * r, 0.055), (r, 0.095))
        ball = place.at(0, 0, up + 0.092)
        return (
            *self._stem(place, up + 0.01),
            revolved(place.at(0, 0, up), cup, self.shade, sides=40),
            rod(ball, ball + np.array([0.0, 0.0, 1e-3]), 0.72 * r, _OPAL),
        )


def draw_novel_design(rng: np.random.Generator) -> LampDesign:
    """Samples a lamp with head, base and switch in new styles."""
    base = draw(LampDesign, rng)
    style = str(rng.choice(list(RADII)))
    shade = Material(_COLORS[rng.integers(len(_COLORS))], 0.4)
    head = NovelHead(
        style=style,
        radius=rng.uniform(*RADII[style]),
        height=rng.uniform(0.30, 0.40),
        stem=rng.uniform(0.010, 0.013),
        lean=0.0,
        side=int(rng.choice([-1, 1])),
        metal=METALS[rng.integers(len(METALS))],
        shade=shade,
    )
    red, green, blue = shade.color
    paint = Material((0.7 * red, 0.7 * green, 0.7 * blue), 0.45)
    return replace(
        base,
        head=head,
        bearing=rng.uniform(-0.7, 0.7),
        distance=head.clear_distance(HAND_CLEARANCE) + rng.uniform(0.0, 0.012),
        base_style="stepped",
        thickness=rng.uniform(0.022, 0.034),
        base=paint if rng.random() < 0.6 else head.metal,
        knob_style="fluted",
        knob_radius=rng.uniform(0.0202, 0.0218),
    )
