"""The safety filter: what a target has to be like before it is sent to an arm. Not a safety function: see docs/robot.md.

Pure: time passed and the measured pose are given. Teleoperator and robot apply the same filter; it works in float32 and
changes nothing that it has let through once, bit for bit, so that applying it twice is applying it once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.errors import ConfigurationError, RobotError
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
from lerobot_adamanip.rotations import Array
from lerobot_adamanip.schema import GRIPPER_DIM

Corner = tuple[float, float, float]

HAND_CORNERS = np.array(
    [
        *product((-0.016, 0.016), (-0.103, 0.103), (-0.103, -0.047)),  # the hand's body
        *product((-0.011, 0.011), (-0.053, 0.053), (0.009,)),  # the fingers, open, their tips
    ]
)
"""(12, 3) corners of Franka's hand in the tool's frame [m]: z the approach, y the direction in which fingers close.
The body ends 103 mm above the tool centre point, where the flange is; open fingers reach 9 mm beyond it."""
MAX_REFUSED = 10
"""Malformed targets in a row that end in an error: a device that sends nothing else is broken."""
TURN_SHARES = (1.0, 0.5, 0.25, 0.0)
"""Of a turn, tried one after the other where the hand's corners would leave the box."""
SHORTER = (1.0, 0.999, 0.9)
"""Shares of a step, tried one after the other: float32 may round a step to one that is too long."""
ROUNDING = 2e-7
"""By which bounds are approached [m or rad]: three units in the last place of a float32 near 1."""


@dataclass(frozen=True)
class SafetyLimits:
    """Where the tool may be sent, and how fast.

    Attributes:
        box_lower, box_upper: of the tool and of the hand's corners [m, base frame]; its bottom is the floor.
        speed, angular_speed: of a streamed target [m/s, rad/s].
        lead, angular_lead: of a streamed target over the measured pose [m, rad]: an arm that is held back, or whose
            path is blocked, is not run away from, and pulls with no more than stiffness times this.
        max_dt: time between two targets counts no more than this [s].
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
        least = float(np.linalg.norm(HAND_CORNERS[:, None] - HAND_CORNERS[None], axis=-1).max())
        if not np.isfinite(size).all() or (size <= least).any():
            raise ConfigurationError(
                "The box that the tool may be in is too small for a hand in every orientation.",
                got=f"{tuple(self.box_lower)} ... {tuple(self.box_upper)} m",
                allowed=f"more than {least:.2f} m in each direction, lower corner first",
                hint="the box holds the whole hand, not the tool centre point alone",
            )
        for name in ("speed", "angular_speed", "lead", "angular_lead", "max_dt"):
            if not 0 < getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"The safety limit {name} cannot be used.", got=getattr(self, name), allowed="above 0"
                )

    def reduced_box(self, rotation: Array) -> tuple[Array, Array]:
        """Returns the box of the tool's position in which a hand of this (3, 3) rotation has its corners inside."""
        corners = HAND_CORNERS @ rotation.T
        lower = np.asarray(self.box_lower) - np.minimum(corners.min(axis=0), 0.0)
        return lower, np.asarray(self.box_upper) - np.maximum(corners.max(axis=0), 0.0)

    def contains(self, tcp_in_base: Array, margin: float = 0.0) -> bool:
        """Whether tool and corners are inside; a positive ``margin`` [m] forgives as much."""
        lower, upper = self.reduced_box(tcp_in_base[:3, :3])
        position = tcp_in_base[:3, 3]
        return bool((position >= lower - margin).all() and (position <= upper + margin).all())


class SafetyFilter:
    """Makes targets safe to send, one after the other.

    A streamed target leaves the last one by no more than ``speed * dt`` and the measured pose by no more than ``lead``,
    and stays in the box, with the hand's corners. Where these exclude each other, the box comes first, then the lead:
    if the arm was pushed away from the last target by more than the lead, the target follows it (`origin`), and steps
    are counted from there. A key frame is a whole motion, planned within the arm's own limits: it is brought into the
    box and nothing else.

    A malformed target (wrong shape, not finite, no rotation) is refused: the last one stays. Its rotation is
    orthonormalised, its gripper clipped.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self.limits = limits
        self.refused = 0
        self._last: Target | None = None

    @property
    def last(self) -> Target | None:
        """(10,) the target that was let through last; the anchor before the first; None before that."""
        return None if self._last is None else self._last.copy()

    def anchor(self, tcp_in_base: Array, gripper: float, *, margin: float = 0.02) -> Target:
        """Begins anew at the measured pose, which becomes the last target: after connect, recovery and clutch.

        Raises:
            RobotError: the hand is outside the box by more than ``margin`` [m].
        """
        if not self.limits.contains(tcp_in_base, margin):
            lower, upper = self.limits.reduced_box(tcp_in_base[:3, :3])
            raise RobotError(
                "The hand is outside the box that it may be in.",
                got=f"tool at {np.round(tcp_in_base[:3, 3], 3).tolist()} m",
                allowed=f"{np.round(lower, 3).tolist()} ... {np.round(upper, 3).tolist()} m in this orientation",
                hint="guide it inside by hand, or set the box right",
            )
        self._last = self._into_box(placed_at(tcp_in_base, min(max(gripper, 0.0), 1.0))).target
        self.refused = 0
        return self._last.copy()

    def stream(self, target: NDArray[np.generic], tcp_in_base: Array, dt: float) -> Target:
        """Returns the next target of a stream, (10,) float32.

        Args:
            target: (10,) wanted.
            tcp_in_base: (4, 4) measured.
            dt: since the last target [s]; what is negative or not finite counts as none.

        Raises:
            RobotError: `anchor` was not called, or `MAX_REFUSED` malformed targets came in a row.
        """
        return self._accept(target, lambda wanted: self.limited(wanted, tcp_in_base, dt), tcp_in_base)

    def keyframe(self, target: NDArray[np.generic], tcp_in_base: Array) -> Target:
        """Returns a key frame brought into the box, (10,) float32. Arguments and errors as of `stream`."""
        return self._accept(target, lambda wanted: self._into_box(placed(wanted)).target, tcp_in_base)

    def _accept(self, target: NDArray[np.generic], limit: Callable[[Target], Target], tcp_in_base: Array) -> Target:
        wanted = canonical(target)
        if wanted is None:
            self.refused += 1
            if self.refused >= MAX_REFUSED:
                raise RobotError(
                    f"{self.refused} malformed targets in a row.",
                    got=np.asarray(target).tolist(),
                    allowed="(10,) finite numbers: position [m], rotation 6D, gripper",
                    hint="is the device, or the policy, the right one?",
                )
            self._last = self.origin(tcp_in_base)
        else:
            self.refused = 0
            self._last = limit(wanted)
        return self._last.copy()

    # Geometry --------------------------------------------------------------------------------------------------------

    def origin(self, tcp_in_base: Array) -> Target:
        """Returns what steps are counted from: the last target, or where an arm that was pushed away from it drags it.

        Raises `RobotError` before `anchor`.
        """
        return self._origin(self._measured(tcp_in_base)).target

    def measured(self, tcp_in_base: Array) -> Target:
        """Returns what leads are counted from: the measured pose, brought into the box."""
        return self._measured(tcp_in_base).target

    def limited(self, wanted: Target, tcp_in_base: Array, dt: float) -> Target:
        """Returns a well-formed target within box, step and lead; does not become the last one. See `stream`."""
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
            raise RobotError("The safety filter has no pose to begin at: it was not anchored.")
        last = placed(self._last)
        if (lead := self._lead(last, measured)) <= 1.0:
            return last
        dragged = between(measured, last, (1.0 - 1e-5) / lead)
        return dragged if self._lead(dragged, measured) <= 1.0 and self._inside(dragged) else measured

    def _lead(self, pose: Placed, measured: Placed) -> float:
        """How far a target leads the measured pose, as a share of what it may; 1 is the bound."""
        ahead = distance(pose, measured) / self.limits.lead
        return max(ahead, angle(pose, measured) / self.limits.angular_lead)

    def _measured(self, tcp_in_base: Array) -> Placed:
        """The measured pose, in the box: an arm that was pushed out of it is led back."""
        return self._into_box(placed_at(tcp_in_base, 1.0))

    def _inside(self, pose: Placed) -> bool:
        lower, upper = self.limits.reduced_box(pose.rotation)
        return bool((pose.position >= lower).all() and (pose.position <= upper).all())

    def _into_box(self, pose: Placed) -> Placed:
        """A pose with its position moved into the box, rounded inwards."""
        lower, upper = self.limits.reduced_box(pose.rotation)
        position = np.clip(pose.position, lower, upper)
        if (position == pose.position).all():
            return pose
        rounded = position.astype(np.float32)
        rounded = np.where(rounded < lower, np.nextafter(rounded, np.float32(np.inf)), rounded)
        rounded = np.where(rounded > upper, np.nextafter(rounded, np.float32(-np.inf)), rounded)
        return moved_to(pose, rounded, float(pose.target[GRIPPER_DIM]))

    def _turned(self, origin: Placed, goal: Placed, measured: Placed, turn: float) -> Placed:
        """The origin, turned by at most ``turn`` [rad] towards what is wanted, and within the lead."""
        if turn <= 0.0:
            return origin
        ahead, size = turn_vector(measured, goal)
        if size > self.limits.angular_lead:
            goal = turned_by(measured, ahead * ((self.limits.angular_lead - ROUNDING) / size))
        way, size = turn_vector(origin, goal)
        return turned_by(origin, way * min(1.0, turn / size)) if size > 0.0 else origin

    def _moved(self, turned: Placed, goal: Placed, origin: Placed, measured: Placed, step: float) -> Placed:
        """The turned origin, moved towards what is wanted: along the box's sides, within lead and step."""
        position = np.clip(goal.position, *self.limits.reduced_box(turned.rotation))
        if (ahead := math.dist(position, measured.position)) > self.limits.lead:
            lead = self.limits.lead - ROUNDING
            position = measured.position + (position - measured.position) * (lead / ahead)
        if (way := math.dist(position, origin.position)) > step:
            position = origin.position + (position - origin.position) * (max(0.0, step) / way)
        return self._into_box(moved_to(turned, position, float(goal.target[GRIPPER_DIM])))
