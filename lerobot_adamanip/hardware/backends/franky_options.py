"""How the real arm is driven: what its process is told, checked."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from lerobot_adamanip.hardware.limits import MODELS, FrankaLimits, limits_of
from lerobot_adamanip.hardware.motion_outcome import StallRule
from lerobot_adamanip.util import json_fields as checked_json


@dataclass(frozen=True)
class FrankyOptions:
    """Of `FrankyBackend`.

    Attributes:
        address: host name or IP of the arm's controller.
        model: panda or fr3; decides the limits.
        dynamics: share of the model's velocities, accelerations and jerks.
        stiffness, rotational_stiffness: of the Cartesian impedance in the arm's firmware [N/m, N m/rad].
        stall_force, stall_torque: a key frame that takes more is given up [N, N m].
        collision_force, collision_torque: the arm's own reflex [N, N m]; above what a pull may take.
        effort_sign: 1 or -1: makes the external torque what the arm exerts. Measured once per arm: docs/robot.md.
        realtime: whether a real-time kernel is demanded.
        gripper: whether Franka's hand is mounted.
        gripper_speed, grasp_force: of its fingers [m/s, N].
        time_limit: a key frame ends by then [s of the arm's clock], whatever its length.
        period: of the arm's process [s].
    """

    address: str = ""
    model: str = "fr3"
    dynamics: float = 0.05
    stiffness: float = 1000.0
    rotational_stiffness: float = 40.0
    stall_force: float = 30.0
    stall_torque: float = 1.1
    collision_force: float = 60.0
    collision_torque: float = 40.0
    effort_sign: float = 1.0
    realtime: bool = True
    gripper: bool = True
    gripper_speed: float = 0.1
    grasp_force: float = 30.0
    time_limit: float = 30.0
    period: float = 0.02

    @property
    def limits(self) -> FrankaLimits:
        """Of the model."""
        return limits_of(self.model)

    @property
    def stall_rule(self) -> StallRule:
        """When a key frame is given up."""
        return StallRule(self.stall_force, self.stall_torque, self.stiffness, self.rotational_stiffness)


_number = checked_json.number
_OPTIONS = checked_json.table(
    {
        "address": checked_json.text(r"[A-Za-z0-9][A-Za-z0-9.:_-]{0,252}", "a host name or IP address"),
        "model": checked_json.choice(sorted(MODELS)),
        "dynamics": _number(0.001, 1.0),
        "stiffness": _number(10.0, 3000.0),
        "rotational_stiffness": _number(1.0, 300.0),
        "stall_force": _number(1.0, 200.0),
        "stall_torque": _number(0.1, 50.0),
        "collision_force": _number(1.0, 500.0),
        "collision_torque": _number(1.0, 100.0),
        "effort_sign": checked_json.either(_number(1.0, 1.0), _number(-1.0, -1.0)),
        "realtime": checked_json.flag,
        "gripper": checked_json.flag,
        "gripper_speed": _number(0.001, 0.2),
        "grasp_force": _number(1.0, 140.0),
        "time_limit": _number(0.1, 600.0),
        "period": _number(0.001, 0.1),
    }
)


def franky_options(options: dict[str, Any]) -> FrankyOptions:
    """Returns checked options; what is not given has its default. Raises ValueError that names the field."""
    found = FrankyOptions(**_OPTIONS("the arm's options", {**dataclasses.asdict(FrankyOptions()), **options}))
    if found.stall_force >= found.collision_force:
        raise ValueError(
            f"a pull is given up at {found.stall_force:g} N, the arm's reflex comes at {found.collision_force:g} N: "
            "lower stall_force or raise collision_force"
        )
    return found
