"""The contract: one table of features for simulation, demonstrations, policy and robot.

Everything is metric and in the robot's base frame. Rotations travel as 6D vectors, the first two rows of the
rotation matrix flattened (`lerobot_adamanip.contract.rotations`). Hidden state never appears under ``observation.*``:
LeRobot makes every such column a policy input.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT, image_column

POINT_CLOUD = "observation.point_cloud"
STATE = "observation.state"
EFFORT = "observation.effort"
FRONT_IMAGE = image_column(FRONT)
ACTION = "action"
PHASE = "complementary_info.phase"
TRIAL = "complementary_info.trial"
OUTCOME = "complementary_info.outcome"
TRIED = "complementary_info.tried"
FAILED = "complementary_info.failed"
PROGRESS = "complementary_info.progress"
JOINTS = "complementary_info.joints"
EXECUTED = "complementary_info.executed"
"""What the arm was really sent, where a policy drove and ``action`` is what an expert would have done."""
SUCCESS = "next.success"
DONE = "next.done"

POSE_NAMES = ("ee.x.pos", "ee.y.pos", "ee.z.pos", *(f"ee.r6d_{i}.pos" for i in range(6)), "gripper.pos")
"""Position [m], rotation 6D [-], gripper opening [0 closed, 1 open]: the action, and the state's first ten."""
NUM_JOINTS = 7
STATE_NAMES = (
    *POSE_NAMES,
    *(f"joint_{i}.pos" for i in range(1, NUM_JOINTS + 1)),
    *(f"joint_{i}.vel" for i in range(1, NUM_JOINTS + 1)),
)
EFFORT_NAMES = tuple(f"joint_{i}.effort" for i in range(1, NUM_JOINTS + 1))
MAX_OBJECT_JOINTS = 4
"""Of an object; every category has two or fewer."""
JOINT_NAMES = (
    *(f"joint_{i}.pos" for i in range(1, NUM_JOINTS + 1)), "left_finger.pos", "right_finger.pos",
    *(f"object_joint_{i}.pos" for i in range(1, MAX_OBJECT_JOINTS + 1)),
)  # fmt: skip
"""Everything that moves, so that a picture of a row can be made later: arm [rad], fingers [m], then the object's joints
in the order of its links [rad or m], 0 where it has fewer. Tells more than a camera sees, so never a policy's input."""
ACTION_DIM = len(POSE_NAMES)
STATE_DIM = len(STATE_NAMES)
POSITION_DIMS = slice(0, 3)
ROTATION_DIMS = slice(3, 9)
GRIPPER_DIM = 9

DEFAULT_NUM_POINTS = 1024
PAPER_NUM_POINTS = 4096
IMAGE_SIZE = 256
MAX_KEY_FRAMES = 45
"""Per episode. A locked safe takes the adaptive expert 19 to 21."""
FPS = 4
"""Key frames have no clock. Four a second is the paper code's macro-step rate, and a comfortable video speed."""

LABEL_DTYPES = {
    PHASE: "int64", TRIAL: "int64", OUTCOME: "int64", TRIED: "int64", FAILED: "bool", PROGRESS: "float32",
    SUCCESS: "bool", DONE: "bool",
}  # fmt: skip
"""Columns about a row's action and its result: one number each, never a policy's input."""

Statistics = dict[str, dict[str, NDArray[Any]]]
"""Feature key -> statistic name -> values, as LeRobot keeps them."""

FIXED_RANGE_DIMS = (*range(3, 9), GRIPPER_DIM)
"""Dimensions of a pose whose range is known: rotation 6D and gripper statistics are fixed to [-1, 1]."""


def dataset_features(
    num_points: int = DEFAULT_NUM_POINTS, image_size: int = IMAGE_SIZE, *, cameras: Collection[str] = CAMERAS
) -> dict[str, dict[str, Any]]:
    """Returns LeRobotDataset features of a demonstration dataset: key -> {dtype, shape, names}.

    A cloud is one row of numbers, x, y, z of each point in turn: LeRobot's tools cannot edit columns of two dimensions.
    `lerobot_adamanip.contract.pointcloud.as_points` gives the points back.

    Args:
        num_points: points per cloud, N.
        image_size: height and width of images [px].
        cameras: names of those whose images have a column each.
    """
    image = {"dtype": "video", "shape": (image_size, image_size, 3), "names": ["height", "width", "channels"]}
    return {
        POINT_CLOUD: {"dtype": "float32", "shape": (3 * num_points,), "names": None},
        STATE: {"dtype": "float32", "shape": (STATE_DIM,), "names": list(STATE_NAMES)},
        EFFORT: {"dtype": "float32", "shape": (NUM_JOINTS,), "names": list(EFFORT_NAMES)},
        **{image_column(name): dict(image) for name in cameras},
        ACTION: {"dtype": "float32", "shape": (ACTION_DIM,), "names": list(POSE_NAMES)},
        **{key: {"dtype": dtype, "shape": (1,), "names": None} for key, dtype in LABEL_DTYPES.items()},
        EXECUTED: {"dtype": "float32", "shape": (ACTION_DIM,), "names": list(POSE_NAMES)},
        JOINTS: {"dtype": "float32", "shape": (len(JOINT_NAMES),), "names": list(JOINT_NAMES)},
    }


def fix_pose_statistics(stats: Statistics) -> Statistics:
    """Returns dataset statistics with rotation 6D and gripper ranges set to [-1, 1] in state and action.

    For normalising alone: ``meta/stats.json`` holds the statistics of the data. A dimension that hardly varies in the
    demonstrations explodes under LeRobot's normalisation (its denominator is the measured range or deviation); the
    true range of these dimensions is known and needs no scaling.
    """
    fixed = {key: dict(value) for key, value in stats.items()}
    dims = list(FIXED_RANGE_DIMS)
    for key in (STATE, ACTION):
        if key not in fixed:
            continue
        for name, value in (("min", -1.0), ("max", 1.0), ("mean", 0.0), ("std", 1.0), ("q01", -1.0), ("q99", 1.0)):
            if name in fixed[key]:
                array = np.array(fixed[key][name], copy=True)
                array[dims] = value
                fixed[key][name] = array
    return fixed
