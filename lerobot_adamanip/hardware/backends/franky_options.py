"""Options of the real arm's process. They are part of the robot's configuration."""

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
    """Options of the real arm. `check` validates them."""

    address: str = ""
    """Host name or IP address of the arm's controller."""

    model: str = ""
    """Model of the arm: fr3 or panda (FER). It selects the limits."""

    dynamics: float = 0.05
    """Fraction of the model's maximum velocity, acceleration and jerk for planned motions."""

    stiffness: float = 1000.0
    """Translational stiffness of the firmware's Cartesian impedance [N/m]."""

    rotational_stiffness: float = 40.0
    """Rotational stiffness of the firmware's Cartesian impedance [N m/rad]."""

    stall_force: float = 30.0
    """Force [N] above which a key frame ends with the outcome STALLED."""

    stall_torque: float = 1.1
    """Torque [N m] above which a key frame ends with the outcome STALLED."""

    collision_force: float = 60.0
    """Force of the arm's own reflex [N]. Must be above the stall force."""

    collision_torque: float = 40.0
    """Torque of the arm's own reflex, per joint [N m]."""

    effort_sign: float = 1.0
    """Sign, 1 or -1, that makes `joint_i.effort` the torque that the arm exerts. Measure it once, see docs/robot.md."""

    realtime: bool = True
    """Whether to require a real-time kernel."""

    gripper: bool = True
    """Whether a Franka Hand is mounted."""

    gripper_speed: float = 0.1
    """Speed of the fingers [m/s]."""

    grasp_force: float = 30.0
    """Force of a grasp [N]."""

    @property
    def limits(self) -> FrankaLimits:
        """Limits of the model."""
        return MODELS[self.model]

    def check(self) -> None:
        """Raises `ConfigurationError` for a missing address or model, or a value out of bounds."""
        if not self.address or not self.model:
            raise ConfigurationError(
                "It is not specified which arm to use.",
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
            raise ConfigurationError("effort_sign must be a sign.", got=self.effort_sign, allowed="1 or -1", hint="1")
        if self.stall_force >= self.collision_force:
            raise ConfigurationError(
                "A pull must stall before the arm's reflex stops it.",
                got=f"stall_force {self.stall_force:g} N, collision_force {self.collision_force:g} N",
                allowed="stall_force below collision_force",
                hint="lower stall_force or raise collision_force",
            )
