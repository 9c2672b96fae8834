"""Box, speed and lead of the safety filter. The box contains the whole hand, in one pose and during a turn."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from itertools import product

import numpy as np

from lerobot_adamanip.contract.rotations import Array, angle_between, straight_path, transform
from lerobot_adamanip.hardware.arm_process.encoding import message
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError

Corner = tuple[float, float, float]

HAND_CORNERS = np.array(
    [
        *product((-0.016, 0.016), (-0.103, 0.103), (-0.103, -0.047)),  # the hand's body
        *product((-0.011, 0.011), (-0.053, 0.053), (0.009,)),  # the fingers, open, their tips
    ]
)
"""(12, 3) corners of Franka's hand in the tool frame [m]: z is the approach, y the closing direction of the fingers.
The body ends at the flange, 103 mm above the tool centre point. Open fingers reach 9 mm below it."""
MAX_REACH_M = float(np.linalg.norm(HAND_CORNERS, axis=-1).max())
"""Distance of the farthest corner from the tool centre point [m]."""
TURN_STEP_RAD = 0.05
"""Maximum turn between two samples of a path. A corner bulges 0.05 mm between them; the box shrinks by that."""


@message
@dataclass(frozen=True)
class SafetyLimits:
    """Limits of targets.

    Attributes:
        box_lower, box_upper: corners of the box for the tool and the hand [m, base frame]; its bottom is the floor.
        speed, angular_speed: maximum speeds of a streamed target [m/s, rad/s].
        lead, angular_lead: maximum distance of a streamed target from the measured pose [m, rad]. A blocked arm pulls
            with at most stiffness times this.
        max_dt: upper bound of the counted time between two targets [s].
    """

    box_lower: Corner
    box_upper: Corner
    speed: float = 0.10
    angular_speed: float = 0.4
    lead: float = 0.04
    angular_lead: float = 0.15
    max_dt: float = 0.1

    def __post_init__(self) -> None:
        size = np.subtract(self.box_upper, self.box_lower)
        least = 2 * MAX_REACH_M  # room for any turn of the hand about a tool in the middle
        if not np.isfinite(size).all() or (size <= least).any():
            raise ConfigurationError(
                "The safety box is too small for a hand that turns.",
                got=f"{tuple(self.box_lower)} ... {tuple(self.box_upper)} m",
                allowed=f"more than {least:.3f} m in each direction, lower corner first",
                hint="the box holds the whole hand, not the tool centre point alone",
            )
        for name in ("speed", "angular_speed", "lead", "angular_lead", "max_dt"):
            if not 0 < getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"The safety limit {name} cannot be used.", got=getattr(self, name), allowed="above 0"
                )

    def to_json(self) -> str:
        """Returns JSON for `limits_from_json`."""
        return json.dumps(asdict(self), indent=1)

    def reduced_box(self, rotation: Array) -> tuple[Array, Array]:
        """Returns the box of tool positions that keep the hand's corners inside at this rotation (3, 3)."""
        return self._box_without(HAND_CORNERS @ rotation.T)

    def turning_box(self, start: Array, goal: Array) -> tuple[Array, Array]:
        """Returns the box of tool positions in which the hand may turn from one rotation (3, 3) to the other.

        The corners stay inside during the whole turn, for every tool position in this box.
        """
        turn = angle_between(start, goal)
        steps = max(1, math.ceil(turn / TURN_STEP_RAD))
        path = straight_path(transform((0, 0, 0), start), transform((0, 0, 0), goal), np.arange(steps + 1) / steps)
        bulge = MAX_REACH_M * (turn / steps) ** 2 / 8  # of an arc over its chord
        lower, upper = self._box_without((HAND_CORNERS @ path[:, :3, :3].transpose(0, 2, 1)).reshape(-1, 3))
        return lower + bulge, upper - bulge

    def _box_without(self, corners: Array) -> tuple[Array, Array]:
        """Returns the box shrunk by corners (K, 3) around the tool [m, base frame's axes]."""
        lower = np.asarray(self.box_lower) - np.minimum(corners.min(axis=0), 0.0)
        return lower, np.asarray(self.box_upper) - np.maximum(corners.max(axis=0), 0.0)

    def contains(self, tcp_in_base: Array, margin: float = 0.0) -> bool:
        """Returns whether tool and corners are inside the box, up to ``margin`` [m]."""
        lower, upper = self.reduced_box(tcp_in_base[:3, :3])
        position = tcp_in_base[:3, 3]
        return bool((position >= lower - margin).all() and (position <= upper + margin).all())


_POSITIVE = json_fields.number(1e-6, 1e3)
_CORNER = json_fields.listing(json_fields.number(-100.0, 100.0), 3, 3)
_LIMITS = json_fields.table(
    {
        "box_lower": _CORNER,
        "box_upper": _CORNER,
        **dict.fromkeys(("speed", "angular_speed", "lead", "angular_lead", "max_dt"), _POSITIVE),
    }
)


def limits_from_json(content: bytes) -> SafetyLimits:
    """Parses `SafetyLimits.to_json`. Raises ValueError with the field's name, or `ConfigurationError` for the box."""
    return SafetyLimits(**_LIMITS("the safety limits", json_fields.parse(content)))
