"""Removes machine and account names from training configurations."""

from __future__ import annotations

import copy
import functools
import re
from pathlib import Path
from typing import Any

_HUB_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*")
_FOLDERS = ("checkpoints", "data", "models", "output", "outputs", "results", "runs", "tmp", "train")
"""First folders of training paths. They are never Hub owners, even if the folder no longer exists."""
_PRIVATE = (
    ("output_dir",), ("checkpoint_path",), ("dataset", "root"), ("env", "assets"), ("env", "episode_log"),
    ("wandb", "entity"), ("wandb", "notes"), ("wandb", "run_id"),  # `trackio` instead since LeRobot 0.7
    ("trackio", "space_id"), ("trackio", "dataset_id"), ("trackio", "notes"), ("trackio", "run_id"),
)  # fmt: skip
"""Fields of a training configuration that name a machine or an account. All may be null."""


def shareable[Config](config: Config, dataset: str | None = None) -> Config:
    """Returns a copy of a training or policy configuration without private fields.

    Args:
        config: JSON-able configuration, or an object such as ``TrainPipelineConfig``.
        dataset: Hub name of the training dataset, which replaces a local name.
    """
    copied = copy.deepcopy(config)
    for *parents, name in _PRIVATE:
        part: Any = functools.reduce(_field, parents, copied)
        if _field(part, name) is not None:
            _set_field(part, name, None)
    for policy in (copied, _field(copied, "policy")):  # a policy's configuration is alone or inside a training's
        if is_local(_field(policy, "pretrained_path")):
            _set_field(policy, "pretrained_path", None)
    if dataset is not None and (part := _field(copied, "dataset")) is not None:
        _set_field(part, "repo_id", dataset)
    return copied


def is_local(path: object) -> bool:
    """Returns whether a policy's ``pretrained_path`` is a folder, not a Hub name."""
    text = str(path)
    is_name = _HUB_NAME.fullmatch(text) is not None and text.partition("/")[0] not in _FOLDERS
    return path is not None and (not is_name or Path(text).exists())


def _field(part: Any, name: str) -> Any:
    return part.get(name) if isinstance(part, dict) else getattr(part, name, None)


def _set_field(part: Any, name: str, value: object) -> None:
    if isinstance(part, dict):
        part[name] = value
    else:
        setattr(part, name, value)
