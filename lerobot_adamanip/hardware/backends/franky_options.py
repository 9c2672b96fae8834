"""Options of the real arm's process: part of the robot's configuration."""

from __future__ import annotations

import re
from dataclasses import dataclass

from lerobot_adamanip.hardware.arm_process.encoding import message
from lerobot_adamanip.hardware.limits import MODELS, FrankaLimits
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

BOUNDS = {
    "dynamics": (0.001, 1.0), "stiffness": (10.0, 3000.0), "rotational_stiffness": (1.0, 300.0),
    "stall_force": (1.0, 200.0), "stall_torque": (0.1, 50.0), "collision_force": (1.0, 500.0),
    "collision_torque": (1.0, 100.0), "gripper_speed": (0.001, 0.2), "grasp_force": (1.0, 140.0),
}  # fmt: skip


@message
@dataclass(kw_only=True)
class FrankyOptions:
    """How the real arm is driven. `check` refuses what cannot be meant."""

    address: str = ""
    """Host name or IP address of the arm's controller."""

    model: str = ""
    """fr3 or panda (FER): decides the limits."""

    dynamics: float = 0.05
    """Share of the model's velocities, accelerations and jerks that motions are planned with."""

    stiffness: float = 1000.0
    """Of the Cartesian impedance in the arm's firmware [N/m]."""

    rotational_stiffness: float = 40.0
    """Likewise [N m/rad]."""

    stall_force: float = 30.0
    """A key frame that takes more force ends with the outcome STALLED [N]."""

    stall_torque: float = 1.1
    """Likewise [N m]."""

    collision_force: float = 60.0
    """The arm's own reflex [N]; above what a pull may take."""

    collision_torque: float = 40.0
    """Likewise of each joint [N m]."""

    effort_sign: float = 1.0
    """1 or -1, so that `joint_i.effort` is what the arm exerts: measured once per arm, see docs/robot.md."""

    realtime: bool = True
    """Demand a real-time kernel."""

    gripper: bool = True
    """Whether Franka's hand is mounted."""

    gripper_speed: float = 0.1
    """Of the fingers [m/s]."""

    grasp_force: float = 30.0
    """[N]."""

    @property
    def limits(self) -> FrankaLimits:
        """Of the model."""
        return MODELS[self.model]

    def check(self) -> None:
        """Raises `ConfigurationError` for a missing address or model, and for a value out of bounds."""
        if not self.address or not self.model:
            raise ConfigurationError(
                "It is not said which arm this is.",
                got=f"address={self.address!r}, model={self.model!r}",
                allowed="the address of its controller; fr3 or panda",
                hint="--robot.address=172.16.0.2 --robot.model=fr3",
            )
        require_choice("model of arm", self.model, MODELS)
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.:_-]{0,252}", self.address):
            raise ConfigurationError(
                "No address of an arm.", got=repr(self.address), allowed="a host name or IP address", hint="172.16.0.2"
            )
        for name, (lowest, highest) in BOUNDS.items():
            if not lowest <= getattr(self, name) <= highest:
                raise ConfigurationError(
                    f"The option {name} cannot be used.",
                    got=getattr(self, name),
                    allowed=f"{lowest:g} ... {highest:g}",
                    hint=f"--robot.{name}={getattr(FrankyOptions, name)}",
                )
        if self.effort_sign not in (1, -1):
            raise ConfigurationError("effort_sign is a sign.", got=self.effort_sign, allowed="1 or -1", hint="1")
        if self.stall_force >= self.collision_force:
            raise ConfigurationError(
                "A pull has to be given up before the arm's reflex comes.",
                got=f"stall_force {self.stall_force:g} N, collision_force {self.collision_force:g} N",
                allowed="stall_force below collision_force",
                hint="lower stall_force or raise collision_force",
            )
