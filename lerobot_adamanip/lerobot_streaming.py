"""Refuses `--dataset.streaming=true` for our datasets where LeRobot's streaming reader cannot serve the training."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lerobot_adamanip.errors import AdaManipError
from lerobot_adamanip.schema import ACTION

_MARK = "_adamanip_checks_streaming"


def register(is_ours: Callable[[Mapping[str, Any]], bool]) -> None:
    """Makes LeRobot's `make_dataset` check streaming of our datasets. Idempotent.

    Args:
        is_ours: whether a dataset's features are those of one of ours.
    """
    from lerobot.datasets import factory

    stock = factory.StreamingLeRobotDataset
    if hasattr(stock, _MARK):
        return

    def make_streaming(*args: Any, **options: Any) -> Any:
        dataset = stock(*args, **options)
        if is_ours(dataset.meta.features):
            require_streamable(options.get("delta_timestamps") or {}, options.get("max_num_shards", 1))
        return dataset

    setattr(make_streaming, _MARK, True)
    factory.StreamingLeRobotDataset = make_streaming


def require_streamable(delta_timestamps: Mapping[str, list[float]], shards: int) -> None:
    """Raises `AdaManipError` for a training that streaming cannot serve.

    Args:
        delta_timestamps: key -> times of its window, as the policy asks for them [s].
        shards: number of data-loading processes, which is how many shards LeRobot reads.
    """
    if any(time < 0 for time in delta_timestamps.get(ACTION, ())):
        raise AdaManipError(
            "A policy with a history of actions cannot train on a streamed dataset.",
            got="--dataset.streaming=true: LeRobot streams the labels, not the actions that were executed",
            allowed="--dataset.streaming=false, or a policy without a history of actions",
            hint="--dataset.streaming=false",
        )
    if shards < 1:
        raise AdaManipError(
            "LeRobot streams nothing without data-loading processes.",
            got="--dataset.streaming=true --num_workers=0",
            allowed="--num_workers of 1 or more, or --dataset.streaming=false",
            hint="--num_workers=1",
        )
