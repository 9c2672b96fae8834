"""The Panda's inverse kinematics, driven without physics: wherever the arm has been, it comes back."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import MotionLimits, Outcome
from lerobot_adamanip.contract.rotations import pose_vector, rotation_about, transform
from lerobot_env_adamanip.sim.arm_driver import ArmDriver
from lerobot_env_adamanip.sim.kinematics import LEVEL_REST, ArmKinematics, joint_path
from lerobot_env_adamanip.sim.simulation import ArmState, Simulation

pytestmark = pytest.mark.sim
LOST = (4, 11, 20)
"""Draws of goals far to the left after which straight lines alone lead nowhere until the next reset."""


@pytest.fixture(scope="module")
def kinematics() -> ArmKinematics:
    import sapien

    spec = importlib.util.find_spec("mani_skill")
    assert spec is not None
    assert spec.origin is not None
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    loader = scene.create_urdf_loader()
    builder = loader.parse(str(Path(spec.origin).parent / "assets/robots/panda/panda_v2.urdf"))[0][0]
    for link in builder.link_builders:  # shapes would need a renderer
        link.visual_records.clear()
        link.collision_records.clear()
    return ArmKinematics(builder.build(fix_root_link=True), LEVEL_REST)


class Arm:
    """Is at once where it is sent."""

    def __init__(self, kinematics: ArmKinematics) -> None:
        self.qpos, self.fastest, self.kinematics = LEVEL_REST.copy(), 0.0, kinematics
        self.driver = ArmDriver(cast(Simulation, self), control_dt=0.02, stiffness=np.ones(7))

    def arm_state(self) -> ArmState:
        return ArmState(self.qpos.copy(), np.zeros(7), np.full(2, 0.04))

    def tick(self, target: NDArray[np.float64], velocity: NDArray[np.float64], finger: float) -> None:
        self.qpos = np.array(target)
        self.fastest = max(self.fastest, float(np.abs(velocity).max()))


@pytest.mark.parametrize("draw", LOST)
def test_the_arm_comes_back_from_far_left(kinematics: ArmKinematics, draw: int) -> None:
    home, rng, arm = kinematics.tcp_in_base(LEVEL_REST), np.random.default_rng(draw), Arm(kinematics)
    for _ in range(3):
        position = (rng.uniform(0.15, 0.6), rng.uniform(0.65, 0.7), rng.uniform(0.3, 1.0))
        rotation = home[:3, :3] @ rotation_about(rng.normal(size=3), rng.uniform(0, 0.8))
        arm.driver.execute(pose_vector(transform(position, rotation), 1.0))
    felt = arm.driver.execute(pose_vector(home, 1.0))
    assert felt.outcome is Outcome.REACHED
    np.testing.assert_allclose(felt.tcp_in_base[:3, 3], home[:3, 3], atol=0.012)


def test_a_closed_hand_does_not_go_round(kinematics: ArmKinematics) -> None:
    home, arm = kinematics.tcp_in_base(LEVEL_REST), Arm(kinematics)
    arm.driver.execute(pose_vector(home, 0.0))
    far = home.copy()
    far[:3, 3] = (0.95, 0.7, 1.1)
    assert arm.driver.execute(pose_vector(far, 0.0)).outcome is Outcome.UNREACHABLE
    assert arm.driver.execute(pose_vector(far, 1.0)).outcome is Outcome.UNREACHABLE


def test_a_path_in_joint_space_ends_where_it_should_and_is_no_faster() -> None:
    start, end = np.zeros(7), np.array([0.3, -0.1, 0.0, 0.05, 0.0, 0.0, 1.0])
    step = MotionLimits().joint_speed * 0.02
    path = joint_path(start, end, step)
    np.testing.assert_allclose(path[-1], end)
    assert np.abs(np.diff(np.vstack([start, path]), axis=0)).max() <= step + 1e-12
    assert joint_path(start, start, step).shape == (1, 7)
