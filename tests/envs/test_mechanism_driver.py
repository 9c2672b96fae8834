"""The mechanism's driver on an articulation that is a few numbers: no simulator."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_env_adamanip.sim.mechanism_driver import MechanismDriver, named_joints


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


BOTH = ("door", "knob")


def driver(articulation: FakeArticulation, *, hold: bool = True, **hidden: Any) -> MechanismDriver:
    mechanism = make_mechanism(make_object("safe_000"))
    state = mechanism.draw(np.random.default_rng(0), {"locked": True, "direction": 1, **hidden})
    return MechanismDriver(mechanism, state, articulation, hold=hold)


def test_limits_are_the_mechanisms_once_joints_are_released(articulation: FakeArticulation) -> None:
    made = driver(articulation, knob_range=1.0)
    made.apply(())
    assert articulation.limits == {"door": (0.0, 0.0), "knob": (0.0, 1.0)}
    articulation.qpos = np.array([0.0, 0.9])
    made.apply(())
    assert articulation.limits["door"][1] > 0.5
    assert made.joint_positions() == {"door": 0.0, "knob": 0.9}


@pytest.mark.parametrize("locked", [True, False])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_held_joint_stays_whatever_is_hidden(articulation: FakeArticulation, locked: bool, direction: int) -> None:
    made = driver(articulation, locked=locked, direction=direction)
    for drift in (1e-4, 0.3):
        articulation.qpos = np.array([drift, -drift])
        made.apply(BOTH)
        assert articulation.limits == {"door": (0.0, 0.0), "knob": (0.0, 0.0)}
    assert [joint.writes for joint in articulation.active_joints] == [1, 1]


def test_one_joint_is_released_and_the_other_still_held(articulation: FakeArticulation) -> None:
    made = driver(articulation, locked=False, direction=-1, knob_range=1.0)
    made.apply({"door"})
    assert made.held == {"door"}
    assert articulation.limits == {"door": (0.0, 0.0), "knob": (-1.0, 0.0)}
    made.apply(())
    assert articulation.limits["door"][1] > 0.5


def test_a_joint_is_held_where_it_is(articulation: FakeArticulation) -> None:
    made = driver(articulation, knob_range=1.0)
    made.apply(())
    articulation.qpos = np.array([0.0, 0.3])
    made.apply(BOTH)
    articulation.qpos = np.array([0.001, 0.31])
    made.apply(BOTH)
    assert articulation.limits == {"door": (0.0, 0.0), "knob": (0.3, 0.3)}
    made.apply({"door"})
    assert articulation.limits["knob"] == (0.0, 1.0)


def test_limits_are_written_only_when_they_change(articulation: FakeArticulation) -> None:
    made = driver(articulation, hold=False)
    for _ in range(5):
        made.apply(BOTH)
    assert [joint.writes for joint in articulation.active_joints] == [1, 1]


def test_a_name_is_the_longest_that_fits() -> None:
    joints = [SimpleNamespace(name=f"scene-0_box_{name}") for name in ("knob", "left_knob")]
    found = named_joints(SimpleNamespace(active_joints=joints), ("knob", "left_knob"))
    assert found == {"knob": joints[0], "left_knob": joints[1]}


def test_success_is_a_joint_beyond_its_goal(articulation: FakeArticulation) -> None:
    made = driver(articulation, locked=False)
    assert not made.succeeded()
    articulation.qpos = np.array([0.6, 0.0])
    assert made.succeeded()
    assert made.hidden_state()["locked"] is False
