"""The mechanism's driver on an articulation that is a few numbers: no simulator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_env_adamanip.sim.mechanism_driver import MechanismDriver


class FakeJoint:
    def __init__(self, name: str) -> None:
        self.name, self.limits, self.writes = f"scene-0_safe_000_{name}", (-9.0, 9.0), 0

    def set_limits(self, limits: list[list[float]]) -> None:
        self.limits, self.writes = (limits[0][0], limits[0][1]), self.writes + 1


class FakeArticulation:
    """Two joints that stand wherever they are put."""

    def __init__(self) -> None:
        self.active_joints = [FakeJoint("door"), FakeJoint("knob")]
        self.qpos = np.zeros(2)

    def get_qpos(self) -> Any:
        return self.qpos

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        return {joint.name.rsplit("_", 1)[-1]: joint.limits for joint in self.active_joints}


@pytest.fixture
def articulation() -> FakeArticulation:
    return FakeArticulation()


def driver(articulation: FakeArticulation, **hidden: Any) -> MechanismDriver:
    mechanism = make_mechanism(make_object("safe_000"))
    state = mechanism.draw(1, torch.Generator().manual_seed(0), {"locked": True, "direction": 1, **hidden})
    return MechanismDriver(mechanism, state, articulation)


def test_limits_are_the_mechanisms(articulation: FakeArticulation) -> None:
    made = driver(articulation, knob_range=1.0)
    made.apply(hold=False)
    assert articulation.limits == {"door": (0.0, 0.0), "knob": (0.0, 1.0)}
    articulation.qpos = np.array([0.0, 0.9])
    made.apply(hold=False)
    assert articulation.limits["door"][1] > 0.5
    assert made.joint_positions() == {"door": 0.0, "knob": 0.9}


def test_a_held_object_stays_where_it_was_when_the_hold_began(articulation: FakeArticulation) -> None:
    made = driver(articulation)
    articulation.qpos = np.array([0.0, 0.3])
    made.apply(hold=True)
    articulation.qpos = np.array([0.001, 0.31])
    made.apply(hold=True)
    assert made.held
    assert articulation.limits == {"door": (0.0, 0.0), "knob": (0.3, 0.3)}
    made.apply(hold=False)
    assert not made.held
    assert articulation.limits["knob"][1] > 0.9


def test_limits_are_written_only_when_they_change(articulation: FakeArticulation) -> None:
    made = driver(articulation)
    for _ in range(5):
        made.apply(hold=False)
    assert [joint.writes for joint in articulation.active_joints] == [1, 1]


def test_success_is_a_joint_beyond_its_goal(articulation: FakeArticulation) -> None:
    made = driver(articulation, locked=False)
    assert not made.succeeded()
    articulation.qpos = np.array([0.6, 0.0])
    assert made.succeeded()
    assert made.hidden_state()["locked"] is False
