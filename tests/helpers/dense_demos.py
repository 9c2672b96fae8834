"""Toy demonstrations at control rate: key frames of `toy_demos`, driven step by step as an arm that lags."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from toy_demos import NUM_POINTS, REPO_ID, toy_episode, toy_world

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, straight_path

FPS, MOVING, RESTING = 10, 4, 2
"""Steps of a key frame: those in which the arm moves, or pushes, and those in which it waits."""
Rows = list[dict[str, Any]]


def key_frames(seed: int) -> Rows:
    """Rows of an adaptive demonstration at a bottle, one per key frame."""
    return toy_episode(toy_world("bottle_000", seed), "adaptive", seed)


def dense_rows(rows: Rows) -> Rows:
    """Rows at control rate, from key frames: a command is ahead of the arm, which is where the key frames lead it."""
    dense = [step for row, following in itertools.pairwise(rows) for step in _steps(row, following)]
    end = {**rows[-1], schema.KEY_FRAME: rows[-1][schema.ACTION], schema.DIRECTION: np.array([0])}
    return [*dense, end]


def _steps(row: dict[str, Any], following: dict[str, Any]) -> Rows:
    start, reached, goal = row[schema.STATE], following[schema.STATE], row[schema.ACTION]
    shares = np.arange(MOVING + 1) / MOVING
    commands = [*_along(start, goal, shares)[1:], *[_with_gripper(reached, goal)] * RESTING]
    places = [*_along(start, reached, shares), *[reached[: schema.ACTION_DIM]] * RESTING]
    common = {schema.KEY_FRAME: goal, schema.DIRECTION: np.array([0])}
    return [
        {
            **row,
            **common,
            schema.STATE: np.concatenate([places[step], start[schema.ACTION_DIM :]]),
            schema.ACTION: commands[step],
            schema.EXECUTED: commands[step],
            schema.OUTCOME: row[schema.OUTCOME] if step == len(commands) - 1 else np.array([schema.GOES_ON]),
        }
        for step in range(len(commands))
    ]


def _along(start: NDArray[Any], goal: NDArray[Any], shares: NDArray[Any]) -> list[NDArray[np.float32]]:
    """Poses between two: fingers close at once."""
    (first, _), (last, gripper) = pose_from_vector(start[: schema.ACTION_DIM]), pose_from_vector(goal[:10])
    path = [pose_vector(pose, gripper) for pose in straight_path(first, last, shares)]
    return [start[: schema.ACTION_DIM], *path[1:]]


def _with_gripper(pose: NDArray[Any], goal: NDArray[Any]) -> NDArray[np.float32]:
    return np.append(pose[: schema.GRIPPER_DIM], goal[schema.GRIPPER_DIM]).astype(np.float32)


def record_dense_toy(root: Path, episodes: int = 3, *, delta: bool = False, fps: int = FPS) -> Path:
    """Records demonstrations at control rate as a LeRobotDataset; returns its folder.

    With ``delta``, actions are seven numbers, as of ``ee_delta``.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    names = tuple(f"{place}.delta" for place in range(7)) if delta else schema.POSE_NAMES
    features = schema.dense_features(names, schema.STATE_NAMES, cameras=(), num_points=NUM_POINTS, has_effort=True)
    dataset = LeRobotDataset.create(REPO_ID, fps, features, root=root, use_videos=False)
    for seed in range(episodes):
        for row in dense_rows(key_frames(seed)):
            action = row[schema.ACTION][: len(names)]
            dataset.add_frame({**row, schema.ACTION: action, schema.EXECUTED: action})
        dataset.save_episode()
    dataset.finalize()
    return root
