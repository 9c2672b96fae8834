"""Outcome of a key frame on a compliant arm: reached, stalled, or out of time.

An arm of stiffness K that is held back by a force F lags F / K behind its target: the lag of a stall follows from both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Outcome
from lerobot_adamanip.contract.rotations import Array, rotation_vector_from_matrix


@dataclass(frozen=True)
class StallRule:
    """Condition of a stall.

    Attributes:
        force, torque: of the strongest pull [N, N m], as the simulated arm's.
        stiffness, rotational_stiffness: of the arm's controller [N/m, N m/rad].
        ticks: in a row.
    """

    force: float = 30.0
    torque: float = 1.1
    stiffness: float = 1000.0
    rotational_stiffness: float = 40.0
    ticks: int = DEFAULT_MOTION.stall_ticks


def pose_error(tcp_in_base: Array, goal_in_base: Array) -> tuple[float, float]:
    """Returns the distance of two (4, 4) poses [m, rad]."""
    turn = rotation_vector_from_matrix(tcp_in_base[:3, :3].T @ goal_in_base[:3, :3])
    return math.dist(tcp_in_base[:3, 3], goal_in_base[:3, 3]), math.sqrt(float(turn @ turn))


class OutcomeWatch:
    """Judges one key frame, tick by tick.

    Args:
        goal_in_base: (4, 4) goal of the tool.
        rule: of a stall.
        began: by the arm's own clock [s].
        time_limit: for the motion [s].
    """

    SETTLE = 0.5
    """Time for the arm to follow a target that has arrived [s]."""
    RESTS = 0.01
    """Fastest joint of an arm at rest [rad/s]."""
    SNUG = (0.002, 0.01)
    """Error at which settling ends early [m, rad]."""

    def __init__(self, goal_in_base: Array, rule: StallRule, began: float, time_limit: float) -> None:
        self._goal, self._rule = goal_in_base, rule
        self._until, self._strained = began + time_limit, 0
        self._arrived: float | None = None

    def look(
        self, tcp_in_base: Array, desired_in_base: Array, *, running: bool, speed: float, now: float
    ) -> Outcome | None:
        """Returns the outcome; None while the motion is under way.

        Args:
            tcp_in_base: (4, 4) measured.
            desired_in_base: (4, 4) the controller's present target.
            running: whether that still changes.
            speed: of the fastest joint [rad/s].
            now: the arm's own clock [s].
        """
        lag, turned = pose_error(tcp_in_base, desired_in_base)
        rule = self._rule
        strained = lag > rule.force / rule.stiffness or turned > rule.torque / rule.rotational_stiffness
        self._strained = self._strained + 1 if strained else 0
        if self._strained >= rule.ticks:
            return Outcome.STALLED
        if now > self._until:
            return Outcome.TIMEOUT
        if running:
            self._arrived = None
            return None
        self._arrived = now if self._arrived is None else self._arrived
        return self._settled(pose_error(tcp_in_base, self._goal), speed, now - self._arrived)

    def _settled(self, error: tuple[float, float], speed: float, waited: float) -> Outcome | None:
        snug = error[0] < self.SNUG[0] and error[1] < self.SNUG[1] and speed < self.RESTS
        if not snug and waited < self.SETTLE:
            return None
        reached = error[0] <= DEFAULT_MOTION.reached_position and error[1] <= DEFAULT_MOTION.reached_rotation
        return Outcome.REACHED if reached else Outcome.STALLED
