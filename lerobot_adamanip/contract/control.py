"""Control of the arm: key frames, or dense actions at a fixed rate. `dense_codec` converts them."""

from __future__ import annotations

from lerobot_adamanip.contract.schema import NUM_JOINTS, POSE_NAMES, STATE_NAMES

KEYFRAME, DENSE = "keyframe", "dense"
CONTROLS = (KEYFRAME, DENSE)
"""``keyframe``: one step is one key frame; ``dense``: one step is 1/fps seconds."""
RATES = (5, 10, 25)
"""Rates of dense control [Hz]: a step is then a whole number of ticks of the simulator, which has 50 a second."""
EE_DELTA, EE_POSE, JOINT = "ee_delta", "ee_pose", "joint"
POSE, FULL = "pose", "full"
DELTA_POSITION, DELTA_ROTATION = 0.1, 0.5
"""Motion of an ``ee_delta`` action of 1 [m, rad]. ManiSkill's ``pd_ee_delta_pose`` has 0.1 and 0.1, LIBERO 0.05 and
0.5. The arm's own limits of speed hold at every rate, see `MotionLimits`: at 10 Hz it covers 0.045 m a step."""
FINGER_TRAVEL = 0.04
"""Travel of each finger from closed to open [m]."""
_AXES = ("x", "y", "z")
_JOINTS = tuple(f"joint_{i}.pos" for i in range(1, NUM_JOINTS + 1))
ACTION_NAMES = {
    EE_DELTA: (*(f"ee.delta_{a}.pos" for a in _AXES), *(f"ee.delta_r{a}.pos" for a in _AXES), "gripper.command.pos"),
    EE_POSE: POSE_NAMES,
    JOINT: (*_JOINTS, "gripper.pos"),
}
"""Kind of dense action -> names of its numbers. `lerobot-rollout` drops names that do not end in ``.pos`` or ``.vel``.

``ee_delta``: translation and rotation vector from the *measured* tool pose, along the robot base's axes, in units of
    `DELTA_POSITION` and `DELTA_ROTATION`, clipped to +-1; gripper -1 closed ... 1 open. This is the layout of
    ManiSkill's ``pd_ee_delta_pose`` and of LIBERO's relative mode (whose gripper has the opposite sign).
``ee_pose``: the contract's pose, as in key frames and on the robot.
``joint``: positions of the arm's joints [rad], gripper 0 closed ... 1 open.
"""
STATES = {
    POSE: (
        *(f"ee.{a}.pos" for a in _AXES), *(f"ee.r{a}.pos" for a in _AXES), "left_finger.pos", "right_finger.pos",
    ),
    FULL: STATE_NAMES,
}  # fmt: skip
"""Kind of state -> names of its numbers. ``pose``: tool position [m], rotation vector [rad], fingers [m], as LIBERO;
``full``: the contract's state, with joint positions and velocities."""
