"""Options of the real arm's process, and the manufacturer's limits of a Franka by model, since libraries mix them up.

Sources: Franka Robotics' "Robot and interface specifications" and libfranka's ``rate_limiting.h`` of the releases for
each model. `franky-control` 2.0.0 swaps the two models (it uses Panda's limits for libfranka >= 0.10).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from lerobot_adamanip.hardware.arm_process.mailbox import message
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

MODELS: dict[str, dict[str, float | tuple[float, ...]]] = {
    "panda": {
        "translation_velocity": 1.7,
        "translation_acceleration": 13.0,
        "translation_jerk": 6500.0,
        "rotation_velocity": 2.5,
        "rotation_acceleration": 25.0,
        "rotation_jerk": 12500.0,
        "elbow_velocity": 2.175,
        "elbow_acceleration": 10.0,
        "elbow_jerk": 5000.0,
        "joint_velocity": (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
        "joint_acceleration": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
        "joint_jerk": (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    },
    "fr3": {
        "translation_velocity": 3.0,
        "translation_acceleration": 9.0,
        "translation_jerk": 4500.0,
        "rotation_velocity": 2.5,
        "rotation_acceleration": 17.0,
        "rotation_jerk": 8500.0,
        "elbow_velocity": 2.62,
        "elbow_acceleration": 10.0,
        "elbow_jerk": 5000.0,
        "joint_velocity": (2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
        "joint_acceleration": (10.0,) * 7,
        "joint_jerk": (5000.0,) * 7,
    },
}
"""Maxima of the tool, the elbow (third joint) and each joint by model: [m] or [rad], per s, s^2 and s^3."""
JOINT_RANGES = {
    "panda": (
        (-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
        (2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    ),
    "fr3": (
        (-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159),
        (2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159),
    ),
}
"""Lower and upper ends of each joint [rad]."""
BOUNDS = {
    "dynamics": (0.001, 1.0),
    "stiffness": (10.0, 3000.0),
    "stall_force": (1.0, 200.0),
    "collision_force": (1.0, 500.0),
    "grasp_force": (1.0, 140.0),
}
ROTATIONAL_STIFFNESS = 40.0
"""Rotational stiffness of the firmware's Cartesian impedance [N m/rad]."""
STALL_TORQUE, COLLISION_TORQUE = 1.1, 40.0
"""Torque above which a key frame stalls, and torque of the arm's own reflex, per joint [N m]."""
PERIOD = 0.02
"""Time between two looks at a motion [s]."""
GRIPPER_SPEED = 0.1
"""Speed of the fingers [m/s]."""


@message
@dataclass(kw_only=True)
class FrankyOptions:
    """Options of the real arm. `check` validates them."""

    address: str = ""
    """Host name or IP address of the arm's controller."""

    model: str = ""
    """Model of the arm: fr3 or panda (FER). It selects the limits."""

    dynamics: float = 0.03
    """Fraction of the model's maximum velocity, acceleration and jerk for planned motions."""

    stiffness: float = 1000.0
    """Translational stiffness of the firmware's Cartesian impedance [N/m]."""

    stall_force: float = 30.0
    """Force [N] above which a key frame ends with the outcome STALLED."""

    collision_force: float = 60.0
    """Force of the arm's own reflex [N]. Must be above the stall force."""

    effort_sign: float = 1.0
    """Sign, 1 or -1, that makes `joint_i.effort` the torque that the arm exerts. Measure it once, see docs/robot.md."""

    realtime: bool = True
    """Whether to require a real-time kernel."""

    gripper: bool = True
    """Whether to command the Franka Hand. It must be mounted either way: the box is that of the hand."""

    grasp_force: float = 30.0
    """Force of a grasp [N]."""

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
        if self.peak_force >= self.collision_force:
            raise ConfigurationError(
                "A pull must stall before the arm's reflex stops it.",
                got=f"up to {self.peak_force:.0f} N until a blocked arm has braked, with stall_force "
                f"{self.stall_force:g} N, stiffness {self.stiffness:g} N/m and dynamics {self.dynamics:g}",
                allowed=f"less than collision_force, {self.collision_force:g} N",
                hint="lower dynamics or stall_force, or raise collision_force",
            )

    @property
    def peak_force(self) -> float:
        """Force [N] of a blocked pull after it has been noticed and the arm has braked, at the limits of a motion."""
        from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION  # with NumPy, which registration does without

        limits: dict[str, Any] = MODELS[self.model]
        speed, braking = (limits[f"translation_{name}"] * self.dynamics for name in ("velocity", "acceleration"))
        ahead = speed * DEFAULT_MOTION.stall_ticks * PERIOD + speed**2 / (2.0 * braking)
        return float(self.stall_force + self.stiffness * ahead)
