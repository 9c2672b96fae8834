"""Tiny recorded datasets of toy objects, and tiny policies made from them the way LeRobot makes them."""

from __future__ import annotations

import ast
import copy
import functools
import gc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from toy_demos import REPO_ID, TINY, record_toy, toy_world

from lerobot_adamanip.contract import schema

COMMON_TINY: dict[str, Any] = {
    "num_points": 48, "encoder_dims": (16, 24), "encoder_out_dim": 16, "device": "cpu", "push_to_hub": False,
}  # fmt: skip
TOOL_TINY: dict[str, Any] = {
    **COMMON_TINY, "num_anchors": 6, "memory_dim": 16, "n_action_history_steps": 4, "training_points": 24,
    "coarse_points": 32, "refinement_points": 16, "num_refinements": 2,
}  # fmt: skip
UNET_TINY: dict[str, Any] = {
    "down_dims": (32, 64), "num_inference_steps": 2,
}  # fmt: skip
BASE_TINY: dict[str, Any] = {**COMMON_TINY, **UNET_TINY, "num_points": 32}
OF_KEY_FRAMES = ("num_anchors", "num_refinements", "refinement_points")
DP3_TINY: dict[str, dict[str, Any]] = {
    "dense": {**{name: value for name, value in TOOL_TINY.items() if name not in OF_KEY_FRAMES}, **UNET_TINY},
    "keyframe": {**TOOL_TINY, "trunk_dim": 32},
    "dp3": {**BASE_TINY, "n_obs_steps": 1, "n_action_history_steps": 8, "n_action_steps": 1},
    "paper": BASE_TINY,
}
"""Tiny options of each preset of ``dp3_adaptive``."""


@pytest.fixture(scope="module", autouse=True)
def _few_objects() -> Iterator[None]:
    """A policy looks for its dataset among the objects of the process: here not among all that was imported."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture(scope="session")
def toy_root(once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """Static demonstrations at a few bottles, turned and lifted. Not to be written to."""
    return once("toy_static", lambda root: record_toy(root, toy_worlds(), "static"))


@pytest.fixture(scope="session")
def adaptive_toy_root(once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """Adaptive demonstrations at bottles, with failed tries. Not to be written to."""
    return once("toy_adaptive", lambda root: record_toy(root, toy_worlds(), "adaptive"))


def toy_worlds() -> list[Any]:
    return [toy_world("bottle_000", seed) for seed in range(6)]


def build_policy(
    policy_type: str, root: Path, episodes: list[int] | None = None, **changes: Any
) -> tuple[Any, Any, Any, Any]:
    from lerobot.datasets.factory import resolve_delta_timestamps
    from lerobot.policies.factory import make_policy, make_policy_config, make_pre_post_processors

    import lerobot_policy_adamanip  # noqa: F401  (registers them)

    preset = {"preset": "dp3", **changes} if policy_type == "dp3_adaptive" else changes
    sizes = DP3_TINY[preset["preset"]] if policy_type == "dp3_adaptive" else TINY
    config = make_policy_config(policy_type, **{**sizes, **preset})
    stamps = resolve_delta_timestamps(config, _opened(root).meta)
    dataset = copy.copy(_opened(root, episodes and tuple(episodes), repr(stamps)))
    dataset.meta = copy.copy(dataset.meta)
    dataset.meta.stats = copy.deepcopy(dataset.meta.stats)
    policy = make_policy(config, ds_meta=dataset.meta)
    before, after = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    return policy, before, after, dataset


@functools.cache
def _opened(root: Path, episodes: tuple[int, ...] | None = None, stamps: str = "None") -> Any:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    chosen = None if episodes is None else list(episodes)
    return LeRobotDataset(REPO_ID, root=root, episodes=chosen, delta_timestamps=ast.literal_eval(stamps))


@pytest.fixture(scope="session")
def make_toy_policy(toy_root: Path) -> Callable[..., tuple[Any, ...]]:
    """Builds (policy, preprocessor, postprocessor, dataset) through LeRobot's factories; what is given wins."""
    return lambda policy_type, root=toy_root, **changes: build_policy(policy_type, root, **changes)


@pytest.fixture
def make_tiny(adaptive_toy_root: Path) -> Callable[..., tuple[Any, ...]]:
    """As `make_toy_policy`, a ``dp3_adaptive`` from the adaptive demonstrations; of the preset dp3 if none is named."""
    return lambda **changes: build_policy("dp3_adaptive", adaptive_toy_root, **changes)


@pytest.fixture
def make_anchors(make_tiny: Callable[..., tuple[Any, ...]]) -> Callable[..., tuple[Any, ...]]:
    """As `make_tiny`, of the preset keyframe."""
    return lambda **changes: make_tiny(preset="keyframe", **changes)


@pytest.fixture(scope="session")
def batch_of() -> Callable[..., dict[str, Any]]:
    """Collates items of a dataset, all of them if none are named, and preprocesses them: what `forward` is given."""

    def build(dataset: Any, before: Any, *indices: int) -> dict[str, Any]:
        items = [dataset[index] for index in indices or range(len(dataset))]
        return dict(before(torch.utils.data.default_collate(items)))

    return build


@pytest.fixture
def observation_of() -> Callable[..., dict[str, Any]]:
    """Preprocesses the present observation of items: what `select_action` is given at run time."""

    def build(dataset: Any, before: Any, *indices: int, **more: Any) -> dict[str, Any]:
        items = [dataset[index] for index in indices]
        keys = (schema.POINT_CLOUD, schema.STATE, schema.EFFORT)
        seen = {key: torch.stack([present(item, key) for item in items]) for key in keys}
        return dict(before({**seen, **more}))

    return build


def present(item: dict[str, Any], key: str) -> torch.Tensor:
    """The present of an item, which is the last step where it has a window."""
    value: torch.Tensor = item[key]
    return value[-1] if f"{key}_is_pad" in item else value
