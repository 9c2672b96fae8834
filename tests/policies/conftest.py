"""A tiny recorded dataset of toy objects, and tiny point-level policies made from it the way LeRobot makes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from toy_demos import REPO_ID, TINY, record_toy, toy_world


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


@pytest.fixture
def make_toy_policy(toy_root: Path) -> Callable[..., tuple[Any, ...]]:
    """Builds (policy, preprocessor, postprocessor, dataset) through LeRobot's factories; None drops an option."""

    def build(policy_type: str, root: Path = toy_root, **changes: Any) -> tuple[Any, ...]:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
        from lerobot.policies.factory import make_policy, make_policy_config, make_pre_post_processors

        import lerobot_policy_adamanip  # noqa: F401  (registers them)

        dataset = LeRobotDataset(REPO_ID, root=root)
        options = {name: value for name, value in {**TINY, **changes}.items() if value is not None}
        config = make_policy_config(policy_type, **options)
        policy = make_policy(config, ds_meta=dataset.meta)
        before, after = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
        return policy, before, after, dataset

    return build


@pytest.fixture
def batch_of() -> Callable[..., dict[str, Any]]:
    """Collates items of a dataset, all of them if none are named, and preprocesses them: what `forward` is given."""

    def build(dataset: Any, before: Any, *indices: int) -> dict[str, Any]:
        items = [dataset[index] for index in indices or range(len(dataset))]
        return dict(before(torch.utils.data.default_collate(items)))

    return build
