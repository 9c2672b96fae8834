"""Translates errors, states, limits and hand commands from and to `franky`. Imports franky on first use."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.backends.franky_options import COLLISION_TORQUE, JOINT_RANGES, MODELS, FrankyOptions
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_adamanip.util.errors import RobotError

INSTALL = "pip install 'lerobot_env_adamanip[franka]'; older arms need a wheel built for their firmware: docs/robot.md"
HINTS = {
    "NetworkException": "is the address right, the arm unlocked, FCI activated in Desk, no other program connected?",
    "RealtimeException": "a real-time kernel (docs/robot.md); realtime=false for a simulated arm only",
    "IncompatibleVersionException": INSTALL,
}
DOCTOR = "adamanip doctor"
"""Hints by the name of a franky exception, and a default hint."""
MODES = {
    "Idle": ArmMode.IDLE, "Move": ArmMode.MOVING, "Guiding": ArmMode.GUIDING, "Reflex": ArmMode.REFLEX,
    "UserStopped": ArmMode.USER_STOPPED, "AutomaticErrorRecovery": ArmMode.RECOVERING, "Other": ArmMode.OTHER,
}  # fmt: skip
TOOL_IN_FLANGE = transform((0.0, 0.0, 0.1034), rotation_about((0.0, 0.0, 1.0), -np.pi / 4))
"""Tool centre point of the Franka Hand as set by Desk [m]."""
TOOL_MARGIN_M, TOOL_MARGIN_RAD = 0.001, 0.01
"""Tolerance when comparing the arm's tool frame with the Franka Hand's."""
RANGE_MARGIN = 0.02
"""Tolerance of a joint's range [rad]. A larger excess means a wrong arm model."""


def import_franky() -> Any:
    """Returns the module `franky`. Raises `RobotError` if it is not installed."""
    try:
        import franky
    except ImportError as error:
        raise RobotError(
            "The package that drives a Franka is not installed.", got=error, allowed="franky-control 2", hint=INSTALL
        ) from None
    return franky


def connect_robot(franky: Any, options: FrankyOptions) -> Any:
    """Returns a connected `franky.Robot`. Raises `RobotError` with a hint."""
    realtime = franky.RealtimeConfig.Enforce if options.realtime else franky.RealtimeConfig.Ignore
    try:
        return franky.Robot(
            options.address,
            relative_dynamics_factor=1.0,
            default_torque_threshold=COLLISION_TORQUE,
            default_force_threshold=options.collision_force,
            controller_mode=franky.ControllerMode.CartesianImpedance,
            realtime_config=realtime,
        )
    except Exception as error:
        hint = next((hint for name, hint in HINTS.items() if isinstance(error, getattr(franky, name))), DOCTOR)
        what = f"No connection to the arm at {options.address}: {error}"
        raise RobotError(what, got=type(error).__name__, allowed="a reachable arm", hint=hint) from None


def set_limits(robot: Any, options: FrankyOptions) -> dict[str, list[float]]:
    """Writes our limits times ``dynamics`` and returns the values read back, by name.

    Lower limits of `franky` stay. Raises `RobotError` if the values read back differ from the written ones.
    """
    read: dict[str, list[float]] = {}
    for name, target in scaled_limits(options).items():
        limit = getattr(robot, name)
        value = np.minimum(np.array(target), np.atleast_1d(np.asarray(limit.max, float)))
        limit.set(value if len(target) > 1 else float(value[0]))
        read[name] = np.atleast_1d(np.asarray(limit.get(), float)).tolist()
        if read[name] != value.tolist():
            raise RobotError(f"The arm's {name} was set to {value.tolist()} and reads {read[name]}.")
    return read


def scaled_limits(options: FrankyOptions) -> dict[str, list[float]]:
    """Returns our limits times ``dynamics`` by franky's names."""
    limits = MODELS[options.model].items()
    return {f"{name}_limit": (np.atleast_1d(value) * options.dynamics).tolist() for name, value in limits}


def check_joints(qpos: Any, options: FrankyOptions) -> None:
    """Raises `RobotError` for joints outside the model's range: the arm is another model."""
    lower, upper = map(np.array, JOINT_RANGES[options.model])
    outside = (np.asarray(qpos) < lower - RANGE_MARGIN) | (np.asarray(qpos) > upper + RANGE_MARGIN)
    if outside.any():
        raise RobotError(
            f"The arm's joints are not within the range of a {options.model}.",
            got=f"joint {int(np.flatnonzero(outside)[0]) + 1} of {np.round(qpos, 3).tolist()} rad",
            allowed=f"{lower.tolist()} ... {upper.tolist()}",
            hint="is the model right? If it is, guide the arm away from the end of its range",
        )


def check_tool_frame(state: Any) -> None:
    """Raises `RobotError` if the tool frame is not the Franka Hand's."""
    tool = np.array(state.F_T_EE.matrix, dtype=np.float64)
    off, turned = pose_error(tool, TOOL_IN_FLANGE)
    if off > TOOL_MARGIN_M or turned > TOOL_MARGIN_RAD:
        yaw = np.rad2deg(np.arctan2(tool[1, 0], tool[0, 0]))
        raise RobotError(
            "The arm's end effector is not the Franka Hand: every position, and the box, would be off.",
            got=f"F_T_EE at {np.round(tool[:3, 3], 4).tolist()} m, turned by {yaw:.1f} deg about z",
            allowed="[0, 0, 0.1034] m, turned by -45 deg",
            hint="in Desk, set the Franka Hand as end effector, and connect again",
        )


def reading_of(state: Any, gripper: float, effort_sign: float, outcome: Outcome | None) -> ArmReading:
    """Returns the reading of a `franky.RobotState`."""
    return ArmReading(
        stamp=time.perf_counter(),
        robot_time=float(state.time.to_msec()) / 1000.0,
        tcp_in_base=np.array(state.O_T_EE.matrix, dtype=np.float64),
        gripper=gripper,
        qpos=np.array(state.q, dtype=np.float64).ravel(),
        qvel=np.array(state.dq, dtype=np.float64).ravel(),
        effort=effort_sign * np.array(state.tau_ext_hat_filtered, dtype=np.float64).ravel(),
        mode=MODES.get(state.robot_mode.name, ArmMode.OTHER),
        errors=flags_of(state.current_errors),
        outcome=outcome,
    )


def flags_of(errors: Any) -> tuple[str, ...]:
    """Returns the names of the error flags that are set, out of 41."""
    return tuple(name for name in dir(errors) if not name.startswith("_") and getattr(errors, name) is True)
