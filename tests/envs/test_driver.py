"""The key-frame driver against a gantry of three slides and three turns: no simulator, and every number known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.keyframes import MotionLimits, Outcome
from lerobot_adamanip.contract.rotations import (
    angle_between,
    pose_vector,
    rotation_about,
    transform,
)
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.arm_driver import FINGER_OPEN, STREAM_JOINT_ACCELERATION, STREAM_JOINT_SPEED, ArmDriver
from lerobot_env_adamanip.sim.kinematics import IKResult, pose_error
from lerobot_env_adamanip.sim.simulation import ArmState, Simulation

START = np.array([0.5, 0.0, 0.7, 0.0, 0.0, 0.0, 0.0])
STIFFNESS = np.full(7, 500.0)


class Gantry:
    """Simulation and kinematics of a gantry.

    Joints are x, y, z [m] and a rotation vector [rad]; a wall stops x, and what is held stops the fingers.
    """

    def __init__(self, wall: float = np.inf, held: float = 0.0, reach: float = np.inf) -> None:
        self.wall, self.held, self.reach = wall, held, reach
        self.qpos, self.qvel, self.fingers = START.copy(), np.zeros(7), np.full(2, FINGER_OPEN)
        self.ticks, self.kinematics = 0, self

    def tcp_in_base(self, qpos: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return transform(qpos[:3], Rotation.from_rotvec(qpos[3:6]).as_matrix())

    def solve(self, goal: Any, start: Any, **_: Any) -> IKResult:
        wanted = np.concatenate([goal[:3, 3], Rotation.from_matrix(goal[:3, :3]).as_rotvec(), start[6:]])
        qpos = np.concatenate([np.clip(wanted[:3], -self.reach, self.reach), wanted[3:]])
        error = pose_error(self.tcp_in_base(qpos), goal)
        return IKResult(qpos, float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:])))

    @property
    def rest(self) -> Any:
        return START

    def canonical(self, goal: Any) -> IKResult:
        return self.solve(goal, START)

    def arm_state(self) -> ArmState:
        return ArmState(self.qpos.copy(), self.qvel.copy(), self.fingers.copy())

    def tick(self, target: Any, velocity: Any, finger: float) -> None:
        before, self.ticks = self.qpos, self.ticks + 1
        self.qpos = np.concatenate([[min(target[0], self.wall)], target[1:]])
        self.qvel = (self.qpos - before) / 0.02
        self.fingers = np.clip(self.fingers + np.clip(finger - self.fingers, -0.005, 0.005), self.held, FINGER_OPEN)

    def driver(self, **limits: Any) -> ArmDriver:
        simulation, motion = cast(Simulation, self), MotionLimits(**limits)
        return ArmDriver(simulation, control_dt=0.02, stiffness=STIFFNESS, limits=motion)


def goal(x: float = 0.5, y: float = 0.0, z: float = 0.7, turn: float = 0.0, gripper: float = 1.0) -> Any:
    return pose_vector(transform((x, y, z), rotation_about((0.0, 0.0, 1.0), turn)), gripper)


def test_free_goal_is_reached_at_rest_and_without_effort() -> None:
    gantry = Gantry()
    felt = (driver := gantry.driver()).execute(goal(0.6, -0.1, 0.8, turn=0.5))
    assert felt.outcome is Outcome.REACHED
    assert not felt.failed
    np.testing.assert_allclose(felt.tcp_in_base[:3, 3], (0.6, -0.1, 0.8), atol=1e-6)
    assert angle_between(felt.tcp_in_base[:3, :3], rotation_about((0, 0, 1), 0.5)) < 1e-3
    np.testing.assert_allclose(driver.effort, 0.0, atol=1e-9)
    assert np.abs(gantry.qvel).max() < 1e-9


def test_speed_stays_within_the_limits() -> None:
    class Watched(Gantry):
        fastest = 0.0

        def tick(self, target: Any, velocity: Any, finger: float) -> None:
            self.fastest = max(self.fastest, float(np.linalg.norm(velocity[:3])))
            super().tick(target, velocity, finger)

    gantry = Watched()
    gantry.driver().execute(goal(0.9, 0.5, 0.3))
    assert 0.3 < gantry.fastest <= MotionLimits().linear_speed * 1.001


def test_joints_of_a_stream_arrive_within_its_speed_and_acceleration_and_a_joint_at_its_goal_stays() -> None:
    goal, dt = np.array([1.5, -0.4, 0.0, 0.1, 0.9, -1.2, 0.02]), 1 / 60
    stream = SimpleNamespace(_target=np.zeros(7), _joint_velocity=np.zeros(7), _dt=dt, stalled=False)
    for _ in range(300):
        before = stream._joint_velocity
        stream._target = ArmDriver._next_joints(cast("ArmDriver", stream), goal)
        assert np.abs(stream._joint_velocity).max() <= STREAM_JOINT_SPEED + 1e-9
        assert np.abs(stream._joint_velocity - before).max() <= STREAM_JOINT_ACCELERATION * dt + 1e-9
        assert stream._target[2] == 0.0
    np.testing.assert_allclose(stream._target, goal, atol=1e-3)


def test_a_wall_is_felt_and_the_strain_is_given_up() -> None:
    gantry = Gantry(wall=0.55)
    driver = gantry.driver()
    felt = driver.execute(goal(0.7))
    assert felt.outcome is Outcome.STALLED
    assert felt.failed
    assert felt.tcp_in_base[0, 3] == pytest.approx(0.55)
    # Gave up a little behind the wall, far from the goal, and reports the push of that moment.
    assert 500 * 0.0065 < driver.effort[0] < 500 * 0.06
    np.testing.assert_allclose(driver.effort[1:], 0.0, atol=1e-9)
    # The next key frame starts from where the arm is: backing off is free at once.
    assert driver.execute(goal(0.5)).outcome is Outcome.REACHED


def test_a_wall_far_from_the_path_is_not_felt() -> None:
    assert Gantry(wall=0.71).driver().execute(goal(0.7)).outcome is Outcome.REACHED


def test_fingers_close_on_what_is_held() -> None:
    gantry = Gantry(held=0.012)
    driver = gantry.driver()
    assert driver.feedback.gripper == pytest.approx(1.0)
    assert driver.execute(goal(gripper=0.0)).gripper == pytest.approx(0.3)
    assert driver.execute(goal(gripper=1.0)).gripper == pytest.approx(1.0)


def test_out_of_reach_is_told_and_survived() -> None:
    gantry = Gantry(reach=0.75)
    driver = gantry.driver()
    felt = driver.execute(goal(0.9))
    assert felt.outcome is Outcome.UNREACHABLE
    assert 0.5 < felt.tcp_in_base[0, 3] < 0.77
    assert driver.execute(goal(0.5)).outcome is Outcome.REACHED


def test_goals_outside_the_box_are_clipped_to_it() -> None:
    felt = Gantry().driver(max_ticks=10_000).execute(goal(50.0, -50.0, -50.0))
    assert felt.outcome is Outcome.REACHED
    limits = MotionLimits()
    np.testing.assert_allclose(
        felt.tcp_in_base[:3, 3], (limits.reach_upper[0], limits.reach_lower[1], limits.reach_lower[2]), atol=1e-6
    )


def test_time_runs_out() -> None:
    gantry = Gantry()
    felt = gantry.driver(max_ticks=5).execute(goal(0.9))
    assert felt.outcome is Outcome.TIMEOUT
    assert gantry.ticks < 5 + 10


@pytest.mark.parametrize(
    "action", [np.zeros(9), np.zeros((1, 10)), np.zeros(0), np.full(10, np.nan), np.r_[np.zeros(9), np.inf]]
)
def test_malformed_actions_are_refused_and_move_nothing(action: Any) -> None:
    gantry = Gantry()
    driver = gantry.driver()
    with pytest.raises(ConfigurationError, match="Malformed action"):
        driver.execute(action)
    assert gantry.ticks == 0
    assert driver.execute(goal(0.55)).outcome is Outcome.REACHED


FINITE = st.floats(width=32, allow_nan=False, allow_infinity=False)


@settings(max_examples=30, deadline=None)
@given(st_numpy.arrays(np.float32, 10, elements=FINITE))
def test_any_finite_action_ends_finite_and_inside_the_box(action: Any) -> None:
    felt = Gantry().driver().execute(action)
    assert np.isfinite(felt.tcp_in_base).all()
    assert felt.outcome in tuple(Outcome)
    limits = MotionLimits()
    position = felt.tcp_in_base[:3, 3]
    assert (position >= np.asarray(limits.reach_lower) - 1e-6).all()
    assert (position <= np.asarray(limits.reach_upper) + 1e-6).all()
