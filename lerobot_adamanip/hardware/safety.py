"""Safety filter for targets before they are sent to an arm. Not a certified safety function: see docs/robot.md.

Teleoperator and robot apply the same filter. It is pure and idempotent: a filtered target passes a second time
unchanged, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import Array
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.hardware.safety_limits import SafetyLimits
from lerobot_adamanip.hardware.target_geometry import (
    Placed,
    Target,
    angle,
    between,
    canonical,
    distance,
    moved_to,
    placed,
    placed_at,
    turn_vector,
    turned_by,
)
from lerobot_adamanip.util.errors import RobotError

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
        self._last = self._into_box(placed_at(tcp_in_base, min(max(gripper, 0.0), 1.0))).target
        self.refused = 0
        return self._last.copy()

    def stream(self, target: NDArray[np.generic], tcp_in_base: Array, dt: float) -> Target:
        """Returns the next target of a stream, (10,) float32.

        Args:
            target: (10,) wanted target.
            tcp_in_base: (4, 4) measured pose.
            dt: time since the last target [s]; negative or NaN counts as 0.

        Raises:
            RobotError: `anchor` was not called, or `MAX_REFUSED` malformed targets came in a row.
        """
        return self._accept(target, lambda wanted: self.limited(wanted, tcp_in_base, dt), tcp_in_base)

    def keyframe(self, target: NDArray[np.generic], tcp_in_base: Array) -> list[Target]:
        """Returns a path of 1 to 3 targets, each (10,) float32. The last one is the key frame.

        Between two targets all corners of the hand stay in the box, if it starts inside. For arguments and errors see
        `stream`.
        """
        start = placed_at(tcp_in_base, float(self.origin(tcp_in_base)[GRIPPER_DIM]))
        goal = self._accept(target, lambda wanted: self._into_box(placed(wanted)).target, tcp_in_base)
        return [*self._detour(start, placed(goal)), goal]

    def _detour(self, start: Placed, goal: Placed) -> list[Target]:
        """Returns the stops between two poses, so that the hand turns where it has room. The gripper stays."""
        lower, upper = self.limits.turning_box(start.rotation, goal.rotation)
        leaving, arriving = _into(start, lower, upper), _into(goal, lower, upper)
        arriving = moved_to(arriving, arriving.position, float(start.target[GRIPPER_DIM]))
        ways = ((leaving, start), (arriving, goal))
        return [stop.target for stop, end in ways if distance(stop, end) > ROUNDING]

    def _accept(self, target: NDArray[np.generic], limit: Callable[[Target], Target], tcp_in_base: Array) -> Target:
        wanted = canonical(target)
        if wanted is None:
            self.refused += 1
            if self.refused >= MAX_REFUSED:
                raise RobotError(
                    f"{self.refused} malformed targets in a row.",
                    got=np.asarray(target).tolist(),
                    allowed="(10,) finite numbers: position [m], rotation 6D, gripper",
                    hint="check that this is the right device or policy",
                )
            self._last = self.origin(tcp_in_base)
        else:
            self.refused = 0
            self._last = limit(wanted)
        return self._last.copy()

    # Geometry --------------------------------------------------------------------------------------------------------

    def origin(self, tcp_in_base: Array) -> Target:
        """Returns the start point of steps: the last target, or a pose nearer to an arm that was pushed away."""
        return self._origin(self._measured(tcp_in_base)).target

    def limited(self, wanted: Target, tcp_in_base: Array, dt: float) -> Target:
        """Returns a valid target within box, step and lead, without storing it. See `stream`."""
        measured = self._measured(tcp_in_base)
        origin, goal = self._origin(measured), placed(wanted)
        dt = min(dt, self.limits.max_dt) if dt > 0 else 0.0
        step, turn = self.limits.speed * dt, self.limits.angular_speed * dt

        def allowed(pose: Placed) -> bool:
            within = distance(pose, origin) <= step and angle(pose, origin) <= turn
            return within and self._lead(pose, measured) <= 1.0 and self._inside(pose)

        if allowed(goal):
            return wanted
        for share in TURN_SHARES:
            turned = self._turned(origin, goal, measured, (turn - ROUNDING) * share)
            moved = self._moved(turned, goal, origin, measured, step - ROUNDING)
            for shorter in SHORTER:
                pose = moved if shorter == 1.0 else between(origin, moved, shorter)
                if allowed(pose):
                    return pose.target
        return moved_to(origin, origin.position, float(wanted[GRIPPER_DIM])).target

    def _origin(self, measured: Placed) -> Placed:
        if self._last is None:
            raise RobotError("The safety filter has no pose to start at: it was not anchored.")
        last = placed(self._last)
        if (lead := self._lead(last, measured)) <= 1.0:
            return last
        dragged = between(measured, last, (1.0 - 1e-5) / lead)
        return dragged if self._lead(dragged, measured) <= 1.0 and self._inside(dragged) else measured

    def _lead(self, pose: Placed, measured: Placed) -> float:
        """Returns the lead over the measured pose as a fraction of its bound."""
        ahead = distance(pose, measured) / self.limits.lead
        return max(ahead, angle(pose, measured) / self.limits.angular_lead)

    def _measured(self, tcp_in_base: Array) -> Placed:
        return self._into_box(placed_at(tcp_in_base, 1.0))

    def _inside(self, pose: Placed) -> bool:
        lower, upper = self.limits.reduced_box(pose.rotation)
        return bool((pose.position >= lower).all() and (pose.position <= upper).all())

    def _into_box(self, pose: Placed) -> Placed:
        return _into(pose, *self.limits.reduced_box(pose.rotation))

    def _turned(self, origin: Placed, goal: Placed, measured: Placed, turn: float) -> Placed:
        """Returns the origin, turned by at most ``turn`` [rad] towards the goal, within the lead."""
        if turn <= 0.0:
            return origin
        ahead, size = turn_vector(measured, goal)
        if size > self.limits.angular_lead:
            goal = turned_by(measured, ahead * ((self.limits.angular_lead - ROUNDING) / size))
        way, size = turn_vector(origin, goal)
        return turned_by(origin, way * min(1.0, turn / size)) if size > 0.0 else origin

    def _moved(self, turned: Placed, goal: Placed, origin: Placed, measured: Placed, step: float) -> Placed:
        """Returns the turned origin, moved towards the goal along the box's sides, within lead and step."""
        position = np.clip(goal.position, *self.limits.reduced_box(turned.rotation))
        if (ahead := math.dist(position, measured.position)) > self.limits.lead:
            lead = self.limits.lead - ROUNDING
            position = measured.position + (position - measured.position) * (lead / ahead)
        if (way := math.dist(position, origin.position)) > step:
            position = origin.position + (position - origin.position) * (max(0.0, step) / way)
        return self._into_box(moved_to(turned, position, float(goal.target[GRIPPER_DIM])))


def accepted(target: NDArray[np.generic], limits: SafetyLimits) -> Target | None:
    """Returns a target (10,) moved into the box; None for a malformed one."""
    wanted = canonical(target)
    if wanted is None:
        return None
    pose = placed(wanted)
    return _into(pose, *limits.reduced_box(pose.rotation)).target


def _into(pose: Placed, lower: Array, upper: Array) -> Placed:
    """Returns a pose with its position moved into the box and rounded inwards."""
    position = np.clip(pose.position, lower, upper)
    if (position == pose.position).all():
        return pose
    rounded = position.astype(np.float32)
    rounded = np.where(rounded < lower, np.nextafter(rounded, np.float32(np.inf)), rounded)
    rounded = np.where(rounded > upper, np.nextafter(rounded, np.float32(-np.inf)), rounded)
    return moved_to(pose, rounded.astype(np.float64), float(pose.target[GRIPPER_DIM]))
