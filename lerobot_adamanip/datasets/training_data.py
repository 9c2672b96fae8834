"""Training data of a checkpoint, as its ``train_config.json`` names it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.util.errors import AdaManipError


def training_objects(checkpoint: Path) -> list[str]:
    """Returns the ids of the objects that a checkpoint was trained on; none if its dataset is not on this machine."""
    try:
        table = Dataset(_training_root(checkpoint)).table
        return sorted(set(map(str, table["object_id"].drop_null().to_pylist())))
    except (OSError, ValueError, LookupError, TypeError, AdaManipError):  # another kind of dataset, or not available
        return []


def training_info(checkpoint: Path) -> dict[str, Any] | None:
    """Returns LeRobot's description of the training's dataset; None if it is not on this machine."""
    try:
        info = json.loads((_training_root(checkpoint) / "meta" / "info.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return info if isinstance(info, dict) and {"fps", "features"} <= info.keys() else None


def _training_root(checkpoint: Path) -> Path:
    from lerobot.utils.constants import HF_LEROBOT_HOME

    dataset = training_options(checkpoint)["dataset"]
    return Path(dataset["root"] or HF_LEROBOT_HOME / dataset["repo_id"])


def training_options(checkpoint: Path) -> dict[str, Any]:
    """Returns the options of the training; none if the checkpoint, a folder or a name on the Hub, lacks them."""
    try:
        path = checkpoint / "train_config.json"
        if not checkpoint.exists():
            from huggingface_hub import hf_hub_download

            path = Path(hf_hub_download(checkpoint.as_posix(), path.name))
        options = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # the Hub's errors are among them
        return {}
    return options if isinstance(options, dict) else {}
