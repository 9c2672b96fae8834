"""A tiny recorded dataset with video, and tiny policies made from it the way LeRobot makes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import rotation_6d_from_matrix, rotation_about

REPO_ID = "local/tiny"
EPISODE_LENGTHS = (9, 12, 8)
NUM_POINTS = 64
TINY: dict[str, Any] = {
    "preset": "diffusion",
    "num_points": 32,
    "encoder_dims": (16, 24),
    "encoder_out_dim": 16,
    "down_dims": (32, 64),
    "n_groups": 8,
    "diffusion_step_embed_dim": 16,
    "num_train_timesteps": 10,
    "num_inference_steps": 2,
    "device": "cpu",
    "push_to_hub": False,
}
HEADS: dict[str, dict[str, Any]] = {
    "diffusion": {"preset": "diffusion", "history_noise_std": 0.0},
    "anchors": {
        "preset": "fast", "num_anchors": 6, "memory_dim": 16, "trunk_dim": 32, "n_action_history_steps": 4,
        "training_points": 24, "coarse_points": 32, "num_points": 48, "refinement_points": 16, "num_refinements": 2,
    },
}  # fmt: skip
"""Tiny options of each head."""


def _pose(draw: np.random.Generator, position: np.ndarray) -> np.ndarray:
    rotation = rotation_about(draw.normal(size=3), float(draw.uniform(0, 3)))
    return np.concatenate([position, rotation_6d_from_matrix(rotation), [float(draw.integers(2))]]).astype(np.float32)


def _frame(draw: np.random.Generator, tool: np.ndarray, index: int) -> dict[str, Any]:
    action = _pose(draw, tool + draw.normal(scale=0.05, size=3))
    return {
        schema.POINT_CLOUD: draw.uniform((0.3, -0.4, 0.4) * NUM_POINTS, (0.9, 0.4, 1.0) * NUM_POINTS).astype(
            np.float32
        ),
        schema.STATE: np.concatenate([_pose(draw, tool), draw.normal(size=14)]).astype(np.float32),
        schema.EFFORT: draw.normal(size=7).astype(np.float32),
        schema.FRONT_IMAGE: draw.integers(0, 255, (32, 32, 3)).astype(np.uint8),
        schema.ACTION: action,
        schema.PHASE: np.array([index], np.int64),
        schema.TRIAL: np.array([index // 4], np.int64),
        schema.OUTCOME: np.array([index % 3], np.int64),
        schema.TRIED: np.array([index % 3 - 1], np.int64),
        schema.FAILED: np.array([index % 3 == 1]),
        schema.PROGRESS: np.array([0.1 * index], np.float32),
        schema.EXECUTED: action,
        schema.JOINTS: np.zeros(len(schema.JOINT_NAMES), np.float32),
        schema.SUCCESS: np.array([index > 4]),
        schema.DONE: np.array([False]),
        "task": "open the safe",
    }


def present(item: dict[str, Any], key: str) -> torch.Tensor:
    """The present of an item, which is the last step where it has a window."""
    value: torch.Tensor = item[key]
    return value[-1] if f"{key}_is_pad" in item else value


@pytest.fixture(scope="session")
def dataset_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recorded episodes with clouds of 64 points and a small video. Not to be written to."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = tmp_path_factory.mktemp("tiny") / "dataset"
    draw = np.random.default_rng(7)
    dataset = LeRobotDataset.create(REPO_ID, schema.FPS, schema.dataset_features(NUM_POINTS, 32), root=root)
    for length in EPISODE_LENGTHS:
        tool = np.array([0.55, 0.0, 0.7])
        for index in range(length):
            frame = _frame(draw, tool, index)
            dataset.add_frame(frame)
            tool = frame[schema.ACTION][:3].astype(np.float64)
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture
def open_dataset(dataset_root: Path) -> Callable[..., Any]:
    """Opens the dataset with the windows that a configuration asks for, as lerobot-train does."""

    def build(config: Any = None, **options: Any) -> Any:
        from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
        from lerobot.datasets.factory import resolve_delta_timestamps
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        if config is not None:
            meta = LeRobotDatasetMetadata(REPO_ID, root=dataset_root)
            options["delta_timestamps"] = resolve_delta_timestamps(config, meta)
        return LeRobotDataset(REPO_ID, root=dataset_root, **options)

    return build


@pytest.fixture
def heads() -> dict[str, dict[str, Any]]:
    return HEADS


@pytest.fixture
def make_config() -> Callable[..., Any]:
    """Builds a tiny configuration; what is given wins."""

    def build(**changes: Any) -> Any:
        from lerobot_policy_adamanip import DP3AdaptiveConfig

        return DP3AdaptiveConfig(**{**TINY, **changes})

    return build


@pytest.fixture
def make_tiny(make_config: Callable[..., Any], open_dataset: Callable[..., Any]) -> Callable[..., tuple[Any, ...]]:
    """Builds (policy, preprocessor, postprocessor, dataset) through LeRobot's factories."""

    def build(**changes: Any) -> tuple[Any, ...]:
        from lerobot.policies.factory import make_policy, make_pre_post_processors

        config = make_config(**changes)
        dataset = open_dataset(config)
        policy = make_policy(config, ds_meta=dataset.meta)
        before, after = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
        return policy, before, after, dataset

    return build


@pytest.fixture
def observation_of() -> Callable[..., dict[str, Any]]:
    """Preprocesses the present observation of items: what `select_action` is given at run time."""

    def build(dataset: Any, before: Any, *indices: int) -> dict[str, Any]:
        items = [dataset[index] for index in indices]
        keys = (schema.POINT_CLOUD, schema.STATE, schema.EFFORT)
        return dict(before({key: torch.stack([present(item, key) for item in items]) for key in keys}))

    return build
