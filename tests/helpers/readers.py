"""Opens a recorded dataset with the reader under test, and compares what readers give."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

FPS = 4


def opened(root: Path, prepare: Callable[[], object], **options: Any) -> LeRobotDataset:
    prepare()
    deltas = options.pop("deltas", None)
    if deltas is not None:
        options["delta_timestamps"] = {key: [step / FPS for step in steps] for key, steps in deltas.items()}
    return LeRobotDataset("local/reader", root=root, video_backend="pyav", **options)


def assert_same(one: dict[str, Any], other: dict[str, Any], without: tuple[str, ...] = ()) -> None:
    assert [key for key in one if key not in without] == list(other)
    for key, value in other.items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == one[key].dtype, key
            assert value.shape == one[key].shape, key
            assert torch.equal(value, one[key]), key
        else:
            assert value == one[key], key
