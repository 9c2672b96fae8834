"""A key frame as a person would drive it: its speed, its end, and what an arm's readings say of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import pose_from_vector, rotation_about, transform
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.safety import SafetyFilter, SafetyLimits
from lerobot_env_adamanip.twin.played_motion import PATIENCE, PlayedMotion

DT = 1 / 30
LIMITS = SafetyLimits((-0.5, -1.0, -0.3), (1.3, 1.0, 1.5), speed=0.3, angular_speed=1.2)


class Arm:
    """Is where it was sent, but for a wall in x; a wall that pushes back is felt, the end of its reach is not."""

    def __init__(self, wall: float = np.inf, felt: float = 10.0, blocked_fingers: float = 0.0) -> None:
        self.wall, self.felt, self.blocked_fingers = wall, felt, blocked_fingers
        self.tcp, self.gripper, self.effort = transform((0.5, 0.0, 0.7)), 1.0, np.zeros(7)
        self.filter = SafetyFilter(LIMITS)
        self.filter.anchor(self.tcp, 1.0)
        self.fastest = 0.0

    def reading(self) -> ArmReading:
        return ArmReading(0.0, 0.0, self.tcp, self.gripper, np.zeros(7), np.zeros(7), self.effort, ArmMode.IDLE)

    def follow(self, wanted: Any) -> None:
        sent = self.filter.stream(wanted, self.tcp, DT)
        goal, gripper = pose_from_vector(sent)
        self.effort = np.full(7, self.felt if goal[0, 3] > self.wall + 1e-9 else 0.0)
        goal[0, 3] = min(goal[0, 3], self.wall)
        self.fastest = max(self.fastest, float(np.linalg.norm(goal[:3, 3] - self.tcp[:3, 3])) / DT)
        self.tcp = goal
        wanted_fingers = max(gripper, self.blocked_fingers) if gripper < self.gripper else gripper
        self.gripper += float(np.clip(wanted_fingers - self.gripper, -0.1, 0.1))

    def play(self, goal: Any, gripper: float = 1.0, held: float = 1.0, seconds: float = 30.0) -> PlayedMotion:
        motion = PlayedMotion(self.tcp, goal, held, gripper, speed=0.2, angular_speed=0.8, pause=0.2)
        for self.ticks in range(int(seconds / DT)):
            last = self.filter.last
            assert last is not None
            wanted = motion.step(self.reading(), last, DT)
            if motion.outcome is not None:
                return motion
            self.follow(wanted)
        return motion


def test_a_free_goal_is_reached_within_speed() -> None:
    arm = Arm()
    motion = arm.play(transform((0.7, 0.1, 0.8), rotation_about((0, 0, 1), 0.5)))
    assert motion.outcome is Outcome.REACHED
    np.testing.assert_allclose(arm.tcp[:3, 3], (0.7, 0.1, 0.8), atol=1e-4)
    assert 0.15 < arm.fastest <= 0.2001


def test_a_wall_that_pushes_back_is_a_stall_and_the_end_of_reach_is_not() -> None:
    goal = transform((0.8, 0.0, 0.7))
    assert Arm(wall=0.6).play(goal).outcome is Outcome.STALLED
    assert Arm(wall=0.6, felt=0.1).play(goal).outcome is Outcome.UNREACHABLE


def test_closing_waits_for_the_fingers_whatever_they_close_on() -> None:
    arm = Arm(blocked_fingers=0.3)
    motion = arm.play(arm.tcp.copy(), gripper=0.0)
    assert motion.outcome is Outcome.REACHED
    assert motion.feedback(arm.reading()).gripper == pytest.approx(0.3)
    np.testing.assert_allclose(arm.tcp[:3, 3], (0.5, 0.0, 0.7), atol=1e-6)


def test_an_arm_that_never_rests_ends_by_time() -> None:
    class Sliding(Arm):
        slid = 0.0

        def reading(self) -> ArmReading:
            self.slid += 0.005 * DT
            self.tcp = transform((self.tcp[0, 3], self.slid, 0.7))
            return super().reading()

    arm = Sliding(wall=0.6)
    assert arm.play(transform((0.8, 0.0, 0.7)), seconds=PATIENCE + 10).outcome is Outcome.TIMEOUT
    assert arm.ticks * DT > PATIENCE
