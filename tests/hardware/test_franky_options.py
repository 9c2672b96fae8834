"""What is written to the real arm before it moves, with a stand-in for the library."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.hardware.arm import ArmMode
from lerobot_adamanip.hardware.backends import franky
from lerobot_adamanip.hardware.backends.franky_options import MODELS, FrankyOptions
from lerobot_adamanip.hardware.backends.franky_sdk import (
    check_joints,
    check_tool_frame,
    connect_robot,
    flags_of,
    reading_of,
    set_limits,
    wanted_limits,
)
from lerobot_adamanip.util.errors import RobotError

VALUES = {"address": "172.16.0.2", "model": "fr3"}


class Limit:
    """As franky's: no more than it believes the arm can do."""

    def __init__(self, highest: float, *, loses: float = 0.0) -> None:
        self.max, self._value, self._loses = highest, None, loses

    def set(self, value: Any) -> None:
        assert np.max(value) <= self.max
        self._value = np.asarray(value) - self._loses

    def get(self) -> Any:
        return self._value


def robot(highest: float, loses: float = 0.0) -> Any:
    return SimpleNamespace(
        **{name: Limit(highest, loses=loses) for name, _ in wanted_limits(FrankyOptions(model="fr3"))}
    )


@pytest.mark.parametrize("model", MODELS)
def test_what_is_read_back_is_our_table_times_the_dynamics(model: str) -> None:
    options = FrankyOptions(model=model, dynamics=0.05)
    read = set_limits(robot(1e9), options)
    assert read == dict(wanted_limits(options))
    assert read["translation_velocity_limit"] == [MODELS[model].translation.velocity * 0.05]
    assert read["joint_acceleration_limit"] == pytest.approx(np.array(MODELS[model].joint.acceleration) * 0.05)
    assert len(read) == 12


def test_a_limit_that_the_library_believes_to_be_lower_stays_lower_and_one_that_does_not_stick_is_an_error() -> None:
    options = FrankyOptions(model="fr3", dynamics=1.0)
    assert set_limits(robot(1.7), options)["translation_velocity_limit"] == [1.7]
    with pytest.raises(RobotError, match="was set to"):
        set_limits(robot(1e9, loses=0.001), options)


def in_flange(z: float, degrees: float) -> Any:
    tool = transform((0.0, 0.0, z), rotation_about((0, 0, 1), np.deg2rad(degrees)))
    return SimpleNamespace(F_T_EE=SimpleNamespace(matrix=tool))


def test_only_the_hands_tool_frame_is_taken() -> None:
    hand = np.array((0.7071, -0.7071, 0, 0, 0.7071, 0.7071, 0, 0, 0, 0, 1, 0, 0, 0, 0.1034, 1)).reshape(4, 4).T
    check_tool_frame(SimpleNamespace(F_T_EE=SimpleNamespace(matrix=hand)))  # as libfranka tells it, by columns
    for z, degrees in ((0.0, 0.0), (0.1034, 0.0), (0.0, -45.0), (0.107, -45.0), (0.1034, 45.0)):
        with pytest.raises(RobotError, match=r"(?s)not the Franka Hand.*in Desk"):
            check_tool_frame(in_flange(z, degrees))


def test_a_wrong_tool_frame_is_refused_before_anything_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = SimpleNamespace(state=in_flange(0.0, 0.0))  # any other attribute is an error
    monkeypatch.setattr(franky, "import_franky", SimpleNamespace)
    monkeypatch.setattr(franky, "connect_robot", lambda *_: arm)
    with pytest.raises(RobotError, match="not the Franka Hand"):
        franky.FrankyBackend(FrankyOptions(**VALUES)).connect()


def test_the_two_models_are_not_mixed_up() -> None:
    """As `franky` does: an FR3 crosses space faster and accelerates less."""
    panda, fr3 = MODELS["panda"], MODELS["fr3"]
    assert (panda.translation.velocity, fr3.translation.velocity) == (1.7, 3.0)
    assert fr3.translation.acceleration < panda.translation.acceleration
    assert max(fr3.joint.acceleration) < max(panda.joint.acceleration)
    assert fr3.joint.velocity[4] > panda.joint.velocity[4]


def test_an_arm_outside_the_models_range_is_another_arm() -> None:
    panda = np.array((0.0, -0.3, 0.0, -2.2, 0.0, 0.3, 0.8))  # an FR3's joint 6 begins at 0.54
    check_joints(panda, FrankyOptions(model="panda"))
    with pytest.raises(RobotError, match="not within the range of a fr3"):
        check_joints(panda, FrankyOptions(model="fr3"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": ""}, "address"),
        ({"address": "a b"}, "address"),
        ({"model": "fer"}, "fr3, panda"),
        ({"dynamics": 2.0}, "dynamics"),
        ({"stiffness": 5000.0}, "stiffness"),
        ({"effort_sign": 0.5}, "effort_sign"),
        ({"stall_force": 70.0}, "before the arm's reflex"),
        ({"grasp_force": float("nan")}, "grasp_force"),
    ],
)
def test_options_that_cannot_be_meant_are_refused_by_name(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FrankyOptions(**{**VALUES, **options}).check()


def state(**values: Any) -> Any:
    pose = np.eye(4)
    plain = {
        "time": SimpleNamespace(to_msec=lambda: 1500), "O_T_EE": SimpleNamespace(matrix=pose), "q": np.arange(7.0),
        "dq": np.zeros(7), "tau_ext_hat_filtered": np.arange(7.0), "robot_mode": SimpleNamespace(name="Reflex"),
        "current_errors": SimpleNamespace(joint_reflex=True, cartesian_reflex=True, self_collision=False, text="x"),
    }  # fmt: skip
    return SimpleNamespace(**{**plain, **values})


def test_a_state_is_told_in_our_words() -> None:
    reading = reading_of(state(), 0.4, -1.0, Outcome.STALLED)
    assert reading.robot_time == 1.5
    assert reading.mode is ArmMode.REFLEX
    assert reading.errors == ("cartesian_reflex", "joint_reflex")
    assert reading.outcome is Outcome.STALLED
    assert (reading.effort == -np.arange(7.0)).all()
    assert (reading.gripper, reading.qpos.shape, reading.qvel.shape) == (0.4, (7,), (7,))
    assert reading_of(state(robot_mode=SimpleNamespace(name="NewMode")), 1.0, 1.0, None).mode is ArmMode.OTHER


def test_the_real_librarys_flags_are_found_by_name() -> None:
    import franky

    names = [name for name in dir(franky.Errors()) if not name.startswith("_")]
    assert {"joint_reflex", "cartesian_reflex", "communication_constraints_violation"} <= set(names)
    assert flags_of(franky.Errors()) == ()


def test_an_arm_that_is_not_there_is_one_clear_error_with_a_hint() -> None:
    import franky

    with pytest.raises(RobotError, match=r"(?s)No connection to the arm at 127\.0\.0\.1.*try:.*address right"):
        connect_robot(franky, FrankyOptions(address="127.0.0.1", model="fr3", realtime=False))
