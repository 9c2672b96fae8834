"""Removes machine and account names from training configurations."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping
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


def shareable(training: Mapping[str, Any], dataset: str | None = None) -> dict[str, Any]:
    """Returns a training or policy configuration without private fields.

    Args:
        training: JSON-able configuration.
        dataset: Hub name of the training dataset, which replaces a local name.
    """
    found: dict[str, Any] = json.loads(json.dumps(training))
    for *parents, name in _PRIVATE:
        place: Any = found
        for parent in parents:
            place = place.get(parent) or {}
        if name in place:
            place[name] = None
    for policy in (found, found.get("policy") or {}):  # a policy's configuration is alone or inside a training's
        if is_local(policy.get("pretrained_path")):
            policy["pretrained_path"] = None
    if dataset is not None and isinstance(found.get("dataset"), dict):
        found["dataset"]["repo_id"] = dataset
    return found


def shareable_copy(training: Any) -> Any:
    """Returns a copy of a ``TrainPipelineConfig`` without private fields, for LeRobot's own push."""
    found = copy.deepcopy(training)
    for *parents, name in _PRIVATE:
        place: Any = found
        for parent in parents:
            place = getattr(place, parent, None)
        if hasattr(place, name):
            setattr(place, name, None)
    if is_local(getattr(found.policy, "pretrained_path", None)):
        found.policy.pretrained_path = None
    return found


def is_local(path: object) -> bool:
    """Returns whether a policy's ``pretrained_path`` is a folder, not a Hub name."""
    text = str(path)
    is_name = _HUB_NAME.fullmatch(text) is not None and text.partition("/")[0] not in _FOLDERS
    return path is not None and (not is_name or Path(text).exists())
