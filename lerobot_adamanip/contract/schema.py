"""The contract: one table of features for simulation, demonstrations, policy and robot.

Everything is metric and in the robot's base frame. Rotations are 6D vectors, the first two rows of the
rotation matrix flattened (`lerobot_adamanip.contract.rotations`). Hidden state never appears under ``observation.*``:
LeRobot makes every such column a policy input.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
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
"""Action sent to the arm. Where a policy drove it differs from ``action``, which is then the expert's correction."""
DIRECTION = "complementary_info.direction"
KEY_FRAME = "complementary_info.key_frame"
"""Key frame, (10,), that a dense row is part of. It ends in the row whose outcome is not `GOES_ON`."""
GOES_ON = -1
"""Outcome of a dense row that does not end its key frame."""
SUCCESS = "next.success"
DONE = "next.done"

POSE_NAMES = ("ee.x.pos", "ee.y.pos", "ee.z.pos", *(f"ee.r6d_{i}.pos" for i in range(6)), "gripper.pos")
"""Position [m], rotation 6D [-], gripper opening [0 closed, 1 open]: the action, and the first ten state values."""
NUM_JOINTS = 7
STATE_NAMES = (
    *POSE_NAMES,
    *(f"joint_{i}.pos" for i in range(1, NUM_JOINTS + 1)),
    *(f"joint_{i}.vel" for i in range(1, NUM_JOINTS + 1)),
)
EFFORT_NAMES = tuple(f"joint_{i}.effort" for i in range(1, NUM_JOINTS + 1))
MAX_OBJECT_JOINTS = 4
"""Largest number of joints of an object; today's categories have at most two."""
JOINT_NAMES = (
    *(f"joint_{i}.pos" for i in range(1, NUM_JOINTS + 1)), "left_finger.pos", "right_finger.pos",
    *(f"object_joint_{i}.pos" for i in range(1, MAX_OBJECT_JOINTS + 1)),
)  # fmt: skip
"""All joint positions, for rendering a row later: arm [rad], fingers [m], then the object's joints in the order of its
links [rad or m], padded with 0. They contain more than a camera sees, so they are never a policy input."""
ACTION_DIM = len(POSE_NAMES)
STATE_DIM = len(STATE_NAMES)
POSITION_DIMS = slice(0, 3)
ROTATION_DIMS = slice(3, 9)
GRIPPER_DIM = 9

DEFAULT_NUM_POINTS = 1024
PAPER_NUM_POINTS = 4096
IMAGE_SIZE = 256
MAX_KEY_FRAMES = 45
"""Per episode. The adaptive expert needs 19 to 21 for a locked safe."""
FPS = 4
"""Nominal, as key frames have no fixed duration: the rate of the paper code's macro steps, comfortable for videos."""

LABEL_DTYPES = {
    PHASE: "int64", TRIAL: "int64", OUTCOME: "int64", TRIED: "int64", FAILED: "bool", PROGRESS: "float32",
    SUCCESS: "bool", DONE: "bool",
}  # fmt: skip
"""Columns that label a row's action and its result: one number each, never a policy input."""

Statistics = dict[str, dict[str, NDArray[Any]]]
"""Feature key -> statistic name -> values, as LeRobot keeps them."""

FIXED_RANGE_DIMS = (*range(3, 9), GRIPPER_DIM)
"""Dimensions of a pose whose range is known: rotation 6D and gripper statistics are fixed to [-1, 1]."""
FIXED_STATISTICS = {
    "min": -1.0, "q01": -1.0, "q10": -1.0, "mean": 0.0, "q50": 0.0, "q90": 1.0, "q99": 1.0, "max": 1.0, "std": 1.0,
}  # fmt: skip
"""Values of these statistics."""


def dataset_features(
    num_points: int = DEFAULT_NUM_POINTS, image_size: int = IMAGE_SIZE, *, cameras: Collection[str] = (FRONT,)
) -> dict[str, dict[str, Any]]:
    """Returns LeRobotDataset features of a demonstration dataset: key -> {dtype, shape, names}.

    A cloud is stored flat, x, y, z of each point in turn, because LeRobot's tools cannot edit two-dimensional columns.
    `lerobot_adamanip.contract.pointcloud.as_points` restores the points.

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


def dense_features(
    action: Sequence[str],
    state: Sequence[str],
    *,
    image_size: int = IMAGE_SIZE,
    cameras: Collection[str] = CAMERAS,
    num_points: int | None = None,
    has_effort: bool = False,
) -> dict[str, dict[str, Any]]:
    """Returns LeRobotDataset features at control rate, as `dataset_features` does for key frames.

    Args:
        action: names of its numbers, see `contract.control`.
        state: likewise.
        image_size: height and width of images [px].
        cameras: names of those whose images have a column each.
        num_points: points per cloud; None for no clouds.
        has_effort: whether there is the effort.
    """
    features = dataset_features(num_points or 1, image_size, cameras=cameras)
    for key, is_present in ((POINT_CLOUD, num_points is not None), (EFFORT, has_effort)):
        if not is_present:
            del features[key]
    for key, names in ((STATE, state), (ACTION, action), (EXECUTED, action), (KEY_FRAME, POSE_NAMES)):
        features[key] = {"dtype": "float32", "shape": (len(names),), "names": list(names)}
    features[DIRECTION] = {"dtype": "int64", "shape": (1,), "names": None}
    return features


def fix_pose_statistics(stats: Statistics) -> Statistics:
    """Returns dataset statistics with rotation 6D and gripper ranges set to [-1, 1] in state and action.

    LeRobot divides by the measured range or deviation, so a dimension that hardly varies in the demonstrations would
    explode. The true range of these dimensions is known and needs no scaling: then none of LeRobot's normalisations (by
    range, deviation, or quantiles 1 % to 99 % and 10 % to 90 %) changes them.
    """
    fixed = {key: dict(value) for key, value in stats.items()}
    dims = list(FIXED_RANGE_DIMS)
    for key in (STATE, ACTION):
        if key not in fixed:
            continue
        for name, value in FIXED_STATISTICS.items():
            if name in fixed[key]:
                array = np.array(fixed[key][name], copy=True)
                array[dims] = value
                fixed[key][name] = array
    return fixed
