"""Felt tries: the commanded and the measured motion of a closed hand. One definition for key frames and control rate.

A felt try needs nothing but tool poses, finger openings and commands, which a real robot has too. It is no label:
`lerobot_adamanip.episode.tries` defines the labels, from the simulator's contacts and joints.

A closed hand *pushes* in a step if it holds something and is commanded to move, or is empty and is commanded forward.
A key frame with a push is a try. At control rate a try is a *stroke*: steps in which the hand pushes in one direction.
The hand was *blocked* if it covered less than `FELT_SHARE` of the commanded motion, and else it *moved*. An empty hand
that follows its command has touched nothing; that is no try. Nor does a hand push at control rate that still moves
against its command: an earlier motion settles. There a command may be farther than the arm gets in a try's time: a hand
that covers `FREE_REACH` of what the arm can is not blocked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import CLOSED_HAND, DEFAULT_MOTION, EMPTY_HAND, OPEN_HAND
from lerobot_adamanip.contract.memory import MOTION_UNITS
from lerobot_adamanip.contract.rotations import rotation_vector_from_matrix

Array = NDArray[np.float64]
MIN_SHIFT_M, MIN_TURN_RAD = 0.008, 0.1
"""Least commanded motion of a key frame that is a push; a grip that settles moves less."""
MIN_LAG_M, MIN_LAG_RAD = 0.004, 0.04
"""Least lag of a pushing hand behind its command at control rate. A hand that holds a part at rest lags by up to
0.001 m and 0.016 rad, one that moves or is blocked by 0.01 m or 0.05 rad."""
SAME_DIRECTION = 0.5
"""Least cosine between the commanded motions of two steps of a stroke, and of two tries that are the same."""
FELT_SHARE = 0.2
"""Least share of a commanded motion that a hand covers if it moves. A blocked hand covers up to 0.18, because fingers
and arm give way."""
FREE_SHARE = 0.8
"""Share of a commanded motion from which on an empty hand has touched nothing. A pressed button lets it cover 0.5."""
MIN_STROKE = 0.1
"""Least size of a stroke's commanded motion in `MOTION_UNITS`."""
HELD_S, HELD_SPEED = 0.3, 1.0
"""Time for which the hand is held back before an unfinished try counts as felt [s], and its greatest speed along its
command then, in `MOTION_UNITS` a second: 5 cm or 0.5 rad."""
FREE_REACH = 0.5
"""Share from which on a hand moves freely, of the way from rest that the arm's limits allow in a try's time. A far
command cannot be covered in a few steps; a blocked hand gets up to 0.3 of that way, because the fingers give way."""
_LIMITS = (
    (DEFAULT_MOTION.linear_speed / MOTION_UNITS[0], DEFAULT_MOTION.linear_acceleration / MOTION_UNITS[0]),
    (DEFAULT_MOTION.angular_speed / MOTION_UNITS[3], DEFAULT_MOTION.angular_acceleration / MOTION_UNITS[3]),
)
"""Speed and acceleration of the simulated arm in `MOTION_UNITS`, of translation and of rotation."""
SAME_PLACE_M = 0.05
"""Largest distance between two places that are the same, for tries that are the same."""


def pushes(shift: Any, turn: Any, forward: Any, opening: Any, min_motion: tuple[float, float]) -> Any:
    """Returns whether hands that are closed push, for numbers, arrays or tensors of one shape.

    A closed hand that is empty can only push, so only its motion forward counts.

    Args:
        shift: size of the commanded translation from the measured pose [m].
        turn: angle of the commanded rotation from it [rad].
        forward: commanded translation along the tool's approach [m].
        opening: measured gripper opening before the command.
        min_motion: least commanded motion of a push [m, rad].
    """
    holds = (opening >= EMPTY_HAND) & (opening <= OPEN_HAND)
    far = (shift > min_motion[0]) | (turn > min_motion[1])
    return holds & far | (forward > min_motion[0])


@dataclass(frozen=True)
class HandPose:
    """Tool pose (4, 4) in the robot base frame [m], and gripper opening, 0 closed ... 1 open."""

    tcp_in_base: Array
    gripper: float


@dataclass(frozen=True)
class FeltEvent:
    """One felt try.

    Attributes:
        start: (4, 4) measured tool pose when the try began, robot base frame [m].
        commanded: (6,) motion in the tool's frame at the start: translation, rotation vector, in `MOTION_UNITS`.
        measured: (6,) measured motion, likewise.
        blocked: whether the hand was held back.
        times: number of equal tries, this one included.
    """

    start: Array
    commanded: Array
    measured: Array
    blocked: bool
    times: int = 1

    def is_repeated_by(self, later: FeltEvent) -> bool:
        """Returns whether a later try has the same direction and result, and began where this one began or ended."""
        end = self.start[:3, 3] + self.start[:3, :3] @ (self.measured[:3] * MOTION_UNITS[:3])
        away = min(np.linalg.norm(later.start[:3, 3] - place) for place in (self.start[:3, 3], end))
        return bool(
            self.blocked == later.blocked and away < SAME_PLACE_M and _is_along(self.commanded, later.commanded)
        )


class FeltTries:
    """Follows the felt tries of one episode.

    Args:
        fps: steps per second at control rate; None if steps are key frames.
    """

    def __init__(self, fps: int | None = None) -> None:
        self._fps, self._held_steps = fps, None if fps is None else max(1, math.ceil(HELD_S * fps))
        self._min_motion = (MIN_SHIFT_M, MIN_TURN_RAD) if fps is None else (MIN_LAG_M, MIN_LAG_RAD)
        self._ended: list[FeltEvent] = []
        self._was_closed = False
        self._stroke: _Stroke | None = None

    @property
    def events(self) -> list[FeltEvent]:
        """Different felt tries, the latest last."""
        present = self._stroke
        if present is None or self._held_steps is None or present.held < self._held_steps:
            return self._ended
        return self._with_stroke(present)

    def after(self, before: HandPose, command: HandPose, after: HandPose) -> None:
        """Advances by one step: a command that was sent from a measured hand, and the measured hand after it."""
        commanded = tool_motion(before.tcp_in_base, command.tcp_in_base)
        is_closed = command.gripper < CLOSED_HAND
        was_closed, self._was_closed = self._was_closed, is_closed
        motion = commanded * MOTION_UNITS
        shift, turn = np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:])
        measured = tool_motion(before.tcp_in_base, after.tcp_in_base)
        share = _share(commanded, measured)
        settles = self._held_steps is not None and share < -FELT_SHARE
        is_push = (
            is_closed
            and was_closed
            and not settles
            and pushes(shift, turn, motion[2], before.gripper, self._min_motion)
        )
        goes_on = is_push and self._stroke is not None and _is_along(commanded, self._stroke.direction)
        if self._stroke is not None and (not goes_on or self._held_steps is None):
            self._end()
        if not is_push:
            return
        start = before if self._stroke is None else self._stroke.start
        steps, held = (0, 0) if self._stroke is None else (self._stroke.steps, self._stroke.held)
        is_slow = self._fps is None or share * float(np.linalg.norm(commanded)) * self._fps < HELD_SPEED
        held = held + 1 if share < FELT_SHARE and is_slow else 0
        self._stroke = _Stroke(start, command.tcp_in_base, after.tcp_in_base, commanded, steps + 1, held)
        if self._held_steps is None:
            self._end()

    def _end(self) -> None:
        assert self._stroke is not None
        self._ended, self._stroke = self._with_stroke(self._stroke), None

    def _with_stroke(self, stroke: _Stroke) -> list[FeltEvent]:
        """Returns the tries with a stroke, unless it moved freely, or was too small or too brief to be one."""
        event, is_empty = stroke.event(), stroke.start.gripper < EMPTY_HAND
        share, size = _share(event.commanded, event.measured), float(np.linalg.norm(event.commanded))
        is_none = is_empty and share >= FREE_SHARE
        if self._fps is not None:
            is_fast = share * size >= FREE_REACH * _reach(event.commanded, stroke.steps / self._fps)
            is_none |= size < MIN_STROKE or (is_fast and (is_empty or event.blocked))
        return self._ended if is_none else _with(self._ended, event)


@dataclass(frozen=True)
class _Stroke:
    """Present stroke: hand at its start, latest command and measured pose, its latest direction, number of its steps,
    and of those since which it is held back.
    """

    start: HandPose
    command: Array
    reached: Array
    direction: Array
    steps: int
    held: int

    def event(self) -> FeltEvent:
        start = self.start.tcp_in_base
        commanded, measured = tool_motion(start, self.command), tool_motion(start, self.reached)
        return FeltEvent(start, commanded, measured, _share(commanded, measured) < FELT_SHARE)


def tool_motion(start: Array, end: Array) -> Array:
    """Returns the motion (6,) from one tool pose (4, 4) to another in the first one's frame, in `MOTION_UNITS`."""
    back = start[:3, :3].T
    shift, turn = back @ (end[:3, 3] - start[:3, 3]), rotation_vector_from_matrix(back @ end[:3, :3])
    return np.asarray(np.concatenate([shift, turn]) / MOTION_UNITS)


def _share(commanded: Array, measured: Array) -> float:
    """Returns the share of a commanded motion that was covered."""
    return float(measured @ commanded) / max(float(commanded @ commanded), 1e-12)


def _reach(motion: Array, seconds: float) -> float:
    """Returns how far the arm gets from rest in this time along a motion (6,), both in `MOTION_UNITS`."""
    reach, size = math.inf, float(np.linalg.norm(motion))
    for part, (speed, acceleration) in zip((motion[:3], motion[3:]), _LIMITS, strict=True):
        rise = min(seconds, speed / acceleration)
        way = acceleration * rise**2 / 2 + speed * (seconds - rise)
        reach = min(reach, way * size / max(float(np.linalg.norm(part)), 1e-9))
    return reach


def _is_along(one: Array, other: Array) -> bool:
    """Returns whether two motions have the same direction."""
    return bool(one @ other > SAME_DIRECTION * np.linalg.norm(one) * np.linalg.norm(other))


def _with(events: list[FeltEvent], event: FeltEvent) -> list[FeltEvent]:
    """Returns events with another one as the latest; it replaces those that it repeats, and counts them."""
    others = [each for each in events if not each.is_repeated_by(event)]
    times = sum(each.times for each in events) - sum(each.times for each in others)
    return [*others, replace(event, times=times + 1)]
