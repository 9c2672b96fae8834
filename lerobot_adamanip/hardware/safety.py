"""Safety filter for targets before they are sent to an arm. Not a certified safety function: see docs/robot.md.

Teleoperator and robot apply the same filter. It is pure and idempotent: a filtered target passes a second time
unchanged, bit for bit. Its box contains the whole hand, in one pose and during a turn.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import Array, angle_between, straight_path, transform
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.hardware.arm_process.mailbox import message
from lerobot_adamanip.hardware.target_geometry import Target, TargetPose, canonical
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

Corner = tuple[float, float, float]

HAND_CORNERS = np.array(
    [
        *product((-0.021, 0.021), (-0.104, 0.104), (-0.130, -0.037)),  # body and plug
        *product((-0.032, 0.032), (-0.032, 0.032), (-0.114, -0.097)),  # flange
        *product((-0.028, 0.028), (-0.032, 0.089), (-0.112, -0.097)),  # wedge beside the flange
        *product((-0.011, 0.011), (-0.057, 0.057), (0.009,)),  # tips of the open fingers
    ]
)
"""(28, 3) corners of Franka's hand in the tool frame [m]: z is the approach, y the closing direction of the fingers.
Their convex hull contains the hand's collision mesh and `calibration.hand_shape.franka_hand` without the last link."""
MAX_REACH_M = float(np.linalg.norm(HAND_CORNERS, axis=-1).max())
"""Distance of the farthest corner from the tool centre point [m]."""
TURN_STEP_RAD = 0.05
"""Maximum turn between two samples of a path. A corner bulges 0.05 mm between them; the box shrinks by that."""
MAX_REFUSED = 10
"""Number of consecutive malformed targets that raises an error."""
ANCHOR_MARGIN_M = 0.02
"""Maximum distance outside the box at which an arm may still start [m]."""
TURN_SHARES = (1.0, 0.5, 0.25, 0.0)
"""Fractions of a turn, tried in order if the hand's corners would leave the box."""
SHORTER = (1.0, 0.999, 0.9)
"""Fractions of a step, tried in order, since float32 rounding may make a step too long."""
ROUNDING = 2e-7
"""Margin to the bounds [m or rad]: three float32 units in the last place near 1."""


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
        min_size = 2 * MAX_REACH_M  # room for any turn of the hand about a tool in the middle
        if not np.isfinite(size).all() or (size <= min_size).any():
            raise ConfigurationError(
                "The safety box is too small for a hand that turns.",
                got=f"{tuple(self.box_lower)} ... {tuple(self.box_upper)} m",
                allowed=f"more than {min_size:.3f} m in each direction, lower corner first",
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

    def into_box(self, pose: TargetPose) -> TargetPose:
        """Returns a target, moved so far that the hand is inside."""
        return pose.into_box(*self.reduced_box(pose.rotation))

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


class SafetyFilter:
    """Limits a sequence of targets.

    A streamed target is at most ``speed * dt`` from the last one and ``lead`` from the measured pose. The hand's
    corners stay in the box. The box has priority over the lead. If the arm was pushed away by more than the lead, the
    target follows it (`origin`), and steps start from there.

    A key frame is a complete motion. The arm plans it within its own limits; the filter only moves it into the box. If
    the hand would leave the box while turning, the tool first moves away from the side, turns, and moves back.

    A malformed target (wrong shape, not finite, no rotation) is refused, and the last one stays. The filter
    orthonormalises rotations and clips the gripper.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self.limits = limits
        self.refused = 0
        self._last: Target | None = None

    @property
    def last(self) -> Target | None:
        """Last returned target (10,); the anchor before the first; None before the anchor."""
        return None if self._last is None else self._last.copy()

    def anchor(self, tcp_in_base: Array, gripper: float) -> Target:
        """Sets the last target to the measured pose. Called after connect, recovery and clutch.

        Raises:
            RobotError: the hand is outside the box by more than `ANCHOR_MARGIN_M`.
        """
        if not self.limits.contains(tcp_in_base, ANCHOR_MARGIN_M):
            lower, upper = self.limits.reduced_box(tcp_in_base[:3, :3])
            raise RobotError(
                "The hand is outside the box.",
                got=f"tool at {np.round(tcp_in_base[:3, 3], 3).tolist()} m",
                allowed=f"{np.round(lower, 3).tolist()} ... {np.round(upper, 3).tolist()} m in this orientation",
                hint="guide it inside by hand, or correct the box",
            )
        self._last = self.limits.into_box(TargetPose.at(tcp_in_base, min(max(gripper, 0.0), 1.0))).target
        self.refused = 0
        return self._last.copy()

    def stream(self, target: NDArray[np.generic], tcp_in_base: Array, dt: float) -> Target:
        """Returns the next target of a stream, (10,) float32.

        Args:
            target: (10,) requested target.
            tcp_in_base: (4, 4) measured pose.
            dt: time since the last target [s]; negative or NaN counts as 0.

        Raises:
            RobotError: `anchor` was not called, or `MAX_REFUSED` malformed targets came in a row.
        """
        goal = self._checked(target)
        self._last = self.origin(tcp_in_base) if goal is None else self._limited(goal, tcp_in_base, dt)
        return self._last.copy()

    def keyframe(self, target: NDArray[np.generic], tcp_in_base: Array) -> list[Target]:
        """Returns a path of 1 to 3 targets, each (10,) float32. The last one is the key frame. Empty if malformed.

        Between two targets all corners of the hand stay in the box, if it starts inside. So the hand turns where it has
        room, with the gripper as last commanded. For arguments and errors see `stream`.
        """
        start = TargetPose.at(tcp_in_base, float(self.origin(tcp_in_base)[GRIPPER_DIM]))
        if (checked := self._checked(target)) is None:
            return []
        self._last = end = self.limits.into_box(TargetPose.of(checked)).target
        goal = TargetPose.of(end)
        box = self.limits.turning_box(start.rotation, goal.rotation)
        leaving, arriving = start.into_box(*box), goal.into_box(*box)
        arriving = arriving.moved_to(arriving.position, start.gripper)
        stops = [stop.target for stop, side in ((leaving, start), (arriving, goal)) if stop.distance(side) > ROUNDING]
        return [*stops, end.copy()]

    def give_up_after(self, sent: Target) -> None:
        """Sets the last target to one of a key frame's path, whose rest was not sent."""
        self._last = sent.copy()

    def _checked(self, target: NDArray[np.generic]) -> Target | None:
        """Returns the canonical target; None if malformed. Raises `RobotError` after `MAX_REFUSED` in a row."""
        goal = canonical(target)
        self.refused = self.refused + 1 if goal is None else 0
        if self.refused >= MAX_REFUSED:
            raise RobotError(
                f"{self.refused} malformed targets in a row.",
                got=np.asarray(target).tolist(),
                allowed="(10,) finite numbers: position [m], rotation 6D, gripper",
                hint="check that this is the right device or policy",
            )
        return goal

    # Geometry --------------------------------------------------------------------------------------------------------

    def origin(self, tcp_in_base: Array) -> Target:
        """Returns the start point of steps: the last target, or a pose nearer to an arm that was pushed away."""
        return self._origin(self._measured(tcp_in_base)).target

    def _limited(self, target: Target, tcp_in_base: Array, dt: float) -> Target:
        """Returns a valid target within box, step and lead."""
        measured = self._measured(tcp_in_base)
        origin, goal = self._origin(measured), TargetPose.of(target)
        dt = min(dt, self.limits.max_dt) if dt > 0 else 0.0
        step, turn = self.limits.speed * dt, self.limits.angular_speed * dt

        def is_allowed(pose: TargetPose) -> bool:
            within = pose.distance(origin) <= step and pose.angle(origin) <= turn
            return within and self._lead(pose, measured) <= 1.0 and self._is_inside(pose)

        if is_allowed(goal):
            return target
        for share in TURN_SHARES:
            turned = self._turned(origin, goal, measured, (turn - ROUNDING) * share)
            moved = self._moved(turned, goal, origin, measured, step - ROUNDING)
            for shorter in SHORTER:
                pose = moved if shorter == 1.0 else origin.towards(moved, shorter)
                if is_allowed(pose):
                    return pose.target
        return origin.moved_to(origin.position, goal.gripper).target

    def _origin(self, measured: TargetPose) -> TargetPose:
        last = TargetPose.of(self._anchored())
        if (lead := self._lead(last, measured)) <= 1.0:
            return last
        dragged = measured.towards(last, (1.0 - 1e-5) / lead)
        return dragged if self._lead(dragged, measured) <= 1.0 and self._is_inside(dragged) else measured

    def _lead(self, pose: TargetPose, measured: TargetPose) -> float:
        """Returns the lead over the measured pose as a fraction of its bound."""
        return max(pose.distance(measured) / self.limits.lead, pose.angle(measured) / self.limits.angular_lead)

    def _measured(self, tcp_in_base: Array) -> TargetPose:
        """Returns the measured pose, in the box, with the gripper as last commanded."""
        return self.limits.into_box(TargetPose.at(tcp_in_base, float(self._anchored()[GRIPPER_DIM])))

    def _anchored(self) -> Target:
        if self._last is None:
            raise RobotError("The safety filter has no pose to start at: it was not anchored.")
        return self._last

    def _is_inside(self, pose: TargetPose) -> bool:
        lower, upper = self.limits.reduced_box(pose.rotation)
        return bool((pose.position >= lower).all() and (pose.position <= upper).all())

    def _turned(self, origin: TargetPose, goal: TargetPose, measured: TargetPose, turn: float) -> TargetPose:
        """Returns the origin, turned by at most ``turn`` [rad] towards the goal, within the lead."""
        if turn <= 0.0:
            return origin
        ahead, size = measured.turn_to(goal)
        if size > self.limits.angular_lead:
            goal = measured.turned_by(ahead * ((self.limits.angular_lead - ROUNDING) / size))
        way, size = origin.turn_to(goal)
        return origin.turned_by(way * min(1.0, turn / size)) if size > 0.0 else origin

    def _moved(
        self, turned: TargetPose, goal: TargetPose, origin: TargetPose, measured: TargetPose, step: float
    ) -> TargetPose:
        """Returns the turned origin, moved towards the goal along the box's sides, within lead and step."""
        position = np.clip(goal.position, *self.limits.reduced_box(turned.rotation))
        if (ahead := math.dist(position, measured.position)) > self.limits.lead:
            lead = self.limits.lead - ROUNDING
            position = measured.position + (position - measured.position) * (lead / ahead)
        if (way := math.dist(position, origin.position)) > max(0.0, step):
            position = origin.position + (position - origin.position) * (max(0.0, step) / way)
        return self.limits.into_box(turned.moved_to(position, goal.gripper))


def accepted(target: NDArray[np.generic], limits: SafetyLimits) -> Target | None:
    """Returns a target (10,) moved into the box; None for a malformed one."""
    goal = canonical(target)
    return None if goal is None else limits.into_box(TargetPose.of(goal)).target
