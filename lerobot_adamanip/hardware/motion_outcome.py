"""Outcome of a key frame on a compliant arm: reached, stalled, or out of time.

An arm with stiffness K lags F / K behind its target under a force F. So force and stiffness give the lag of a stall.
"""

from __future__ import annotations

import math

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Outcome
from lerobot_adamanip.contract.rotations import Array, rotation_vector_from_matrix
from lerobot_adamanip.hardware.backends.franky_options import FrankyOptions


def pose_error(tcp_in_base: Array, goal_in_base: Array) -> tuple[float, float]:
    """Returns the distance between two (4, 4) poses [m, rad]."""
    turn = rotation_vector_from_matrix(tcp_in_base[:3, :3].T @ goal_in_base[:3, :3])
    return math.dist(tcp_in_base[:3, 3], goal_in_base[:3, 3]), math.sqrt(float(turn @ turn))


class OutcomeWatch:
    """Determines the outcome of one key frame, tick by tick.

    Args:
        goal_in_base: (4, 4) goal of the tool.
        options: force, torque and stiffness for the stall test.
        began: start time on the arm's own clock [s].
        time_limit: time limit of the motion [s].
    """

    SETTLE = 0.5
    """Time for the arm to reach a target that no longer moves [s]."""
    RESTS = 0.01
    """Maximum joint speed of an arm at rest [rad/s]."""
    SNUG = (0.002, 0.01)
    """Error below which settling ends early [m, rad]."""

    def __init__(self, goal_in_base: Array, options: FrankyOptions, began: float, time_limit: float) -> None:
        self._goal = goal_in_base
        self._stall_lag = options.stall_force / options.stiffness
        self._stall_turn = options.stall_torque / options.rotational_stiffness
        self._until, self._strained = began + time_limit, 0
        self._arrived: float | None = None

    def look(
        self, tcp_in_base: Array, desired_in_base: Array, *, running: bool, speed: float, now: float
    ) -> Outcome | None:
        """Returns the outcome; None during the motion.

        Args:
            tcp_in_base: (4, 4) measured pose.
            desired_in_base: (4, 4) current target of the controller.
            running: whether that target still changes.
            speed: speed of the fastest joint [rad/s].
            now: time on the arm's own clock [s].
        """
        lag, turned = pose_error(tcp_in_base, desired_in_base)
        strained = lag > self._stall_lag or turned > self._stall_turn
        self._strained = self._strained + 1 if strained else 0
        if self._strained >= DEFAULT_MOTION.stall_ticks:
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
