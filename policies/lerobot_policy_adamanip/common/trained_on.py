"""Log what a checkpoint was trained on: "seen" is a category's split of objects, not the policy's."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

from lerobot_adamanip.util.errors import listed

_logger = logging.getLogger(__name__)


def log_training_objects(checkpoint: Path) -> None:
    """Logs the objects that a checkpoint was trained on, if its dataset is on this machine; else nothing.

    Args:
        checkpoint: folder with ``train_config.json``, as ``lerobot-train`` writes it.
    """
    try:
        training = json.loads((checkpoint / "train_config.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return
    objects = _objects(training.get("dataset") if isinstance(training, dict) else None)
    if objects:
        _logger.info("The policy was trained on %d objects: %s.", len(objects), listed(objects))


def _objects(dataset: Any) -> list[str]:
    """Returns the ids of the objects in a dataset's episodes; none if it is not on this machine or not of ours."""
    from lerobot.utils.constants import HF_LEROBOT_HOME

    from lerobot_adamanip.datasets.reading import episode_table

    if not isinstance(dataset, dict):
        return []
    given = dataset.get("root")
    root = Path(str(given)) if given else HF_LEROBOT_HOME / str(dataset.get("repo_id"))
    if not (root / "meta" / "episodes").is_dir():
        return []
    try:
        return sorted(set(map(str, episode_table(root)["object_id"].to_pylist())))
    except (OSError, ValueError, KeyError, RuntimeError):
        return []
