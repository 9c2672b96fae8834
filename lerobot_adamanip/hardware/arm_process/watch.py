"""Checks in the arm process: malformed targets, and readings that forbid motion."""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.contract.schema import ACTION_DIM, GRIPPER_DIM, ROTATION_DIMS
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, ArmTarget, Array, Execution
from lerobot_adamanip.hardware.arm_process.messages import ServerOptions
from lerobot_adamanip.hardware.motion_outcome import pose_error

ROTATION_ERROR = 1e-3
"""Maximum orthonormality error of a target's rotation rows. The safety filter returns orthonormal rows."""
MAX_LEADS = 2.0
"""Allowed multiple of the filter's lead. It exceeds 1 because this process has a newer reading."""
BOX_ROUNDING = 1e-6
"""Tolerance [m] for float32 targets against the float64 box."""
STOPPED_MODES = {
    ArmMode.REFLEX: "The arm stopped itself (reflex)",
    ArmMode.USER_STOPPED: "The arm's user stop is pressed",
    ArmMode.GUIDING: "The arm is being guided by hand",
}


def malformed(target: ArmTarget, options: ServerOptions, tcp_in_base: Array) -> str | None:
    """Returns why a target is refused, given the measured pose (4, 4); None for a valid target.

    The recorder's filter blocks such targets. This check detects a recorder without the filter.
    """
    pose = target.pose.astype(np.float64)
    if pose.shape != (ACTION_DIM,) or not np.isfinite(pose).all():
        return f"A target that is no pose reached the arm's process: {pose.tolist()}"
    rows = pose[ROTATION_DIMS].reshape(2, 3)
    if np.abs(rows @ rows.T - np.eye(2)).max() > ROTATION_ERROR:
        return f"A target whose rotation is none reached the arm's process: {rows.ravel().tolist()}"
    goal, _ = pose_from_vector(pose)
    if options.limits is None:
        return None
    if not options.limits.contains(goal, BOX_ROUNDING):
        return f"A target with the hand outside the box reached the arm's process: {pose[:GRIPPER_DIM].tolist()}"
    if target.execution is Execution.STREAM:
        ahead, turned = pose_error(tcp_in_base, goal)
        if ahead > MAX_LEADS * options.limits.lead or turned > MAX_LEADS * options.limits.angular_lead:
            return (
                f"A target that jumps reached the arm's process: {ahead:.3f} m, {turned:.3f} rad from where the arm is"
            )
    return None


def trouble(reading: ArmReading, stood_still: float, state_age: float) -> str | None:
    """Returns why the arm must not move; None if it may. ``stood_still``: time since its clock last advanced [s]."""
    if reading.mode in STOPPED_MODES or reading.errors:
        what = STOPPED_MODES.get(reading.mode, "The arm reports errors")
        return f"{what}: {', '.join(reading.errors) or 'no flag is set'}."
    if stood_still > state_age:
        return f"The arm's state is {stood_still:.2f} s old, more than {state_age:g} s: its connection stands still."
    return None
