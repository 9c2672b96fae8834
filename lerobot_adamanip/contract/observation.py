"""Observations: builds the contract's arrays from points and joints, and dataset columns from the arrays."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import image_column
from lerobot_adamanip.contract.keyframes import Feedback
from lerobot_adamanip.contract.memory import MEMORY
from lerobot_adamanip.contract.pointcloud import Cloud, Workspace, farthest_point_order
from lerobot_adamanip.contract.rotations import pose_vector

Observation = Mapping[str, Any]
"""As the environments return it: ``point_cloud`` (N, 3) [m], ``agent_pos`` (24,), ``effort`` (7,) [N m], and
``pixels``, camera -> (H, W, 3), where images are observed. In dense control ``agent_pos`` may be (8,), and clouds and
efforts are there if they are requested. ``environment_state`` (96,) is the memory of events, if it is requested."""


class RepeatedPointsWarning(UserWarning):
    """A cloud has fewer points than requested and repeats some of them."""


def workspace_cloud(points_in_base: Cloud, workspace: Workspace, num_points: int) -> Cloud:
    """Crops (M, 3) points to the workspace and samples ``num_points`` in farthest-point order -> (num_points, 3).

    If the workspace has fewer points, they are repeated from the start, with a `RepeatedPointsWarning`: an occluded
    view must not end an episode.
    """
    inside = points_in_base.take(np.flatnonzero(workspace.contains(points_in_base)), axis=0)
    if len(inside) < num_points:
        # Constant text, so that Python's filter shows the warning once and not at every key frame.
        text = f"The camera sees fewer than num_points={num_points} points in the workspace; the cloud repeats them."
        warnings.warn(text, RepeatedPointsWarning, stacklevel=2)
    return farthest_point_order(inside, num_points)


def state_vector(feedback: Feedback, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> NDArray[np.float32]:
    """Returns the (24,) state of the contract: tool pose, gripper, joint positions and velocities."""
    pose = pose_vector(feedback.tcp_in_base, feedback.gripper)
    return np.concatenate([pose, qpos, qvel]).astype(np.float32)


def observation_columns(observation: Observation) -> dict[str, NDArray[Any]]:
    """Returns the dataset columns of one Gym observation, as copies: the environment may reuse its buffers."""
    columns = {
        key: np.array(observation[name], dtype=np.float32) for name, key in _COLUMNS.items() if name in observation
    }
    if schema.POINT_CLOUD in columns:
        columns[schema.POINT_CLOUD] = columns[schema.POINT_CLOUD].reshape(-1)
    images = {image_column(name): np.array(image, np.uint8) for name, image in observation.get("pixels", {}).items()}
    return {**columns, **images}


_COLUMNS = {
    "point_cloud": schema.POINT_CLOUD, "agent_pos": schema.STATE, "effort": schema.EFFORT, "environment_state": MEMORY,
}  # fmt: skip
