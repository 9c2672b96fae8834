"""Tell what an evaluated policy was trained on: "seen" is a category's split of objects, not the policy's."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from lerobot_adamanip.categories import ALL, CATEGORIES
from lerobot_adamanip.options import EnvironmentOptions
from lerobot_env_adamanip.caller import EVALUATION, held_by_callers

_logger = logging.getLogger(__name__)


class TrainedOn(NamedTuple):
    """The categories of a policy's training data, and its objects where the dataset is still there."""

    categories: frozenset[str]
    objects: frozenset[str] | None


def trained_on(checkpoint: Path) -> TrainedOn | None:
    """Returns what a checkpoint was trained on, by its ``train_config.json``; None if that does not tell."""
    try:
        training = json.loads((checkpoint / "train_config.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(training, dict):
        return None
    objects = _objects(training.get("dataset"))
    if objects is not None:
        from lerobot_adamanip.catalog import category_of

        return TrainedOn(frozenset(map(category_of, objects)), objects)
    env = training.get("env")
    kind = str(env.get("type")) if isinstance(env, dict) else ""
    category = kind.removeprefix("adamanip").removeprefix("_") or ALL
    return TrainedOn(frozenset((category,)), None) if kind.startswith("adamanip_") and category in CATEGORIES else None


def _objects(dataset: Any) -> frozenset[str] | None:
    """The objects of a dataset's episodes; None if it is not on this machine or is not one of this project's."""
    from lerobot.utils.constants import HF_LEROBOT_HOME

    from lerobot_adamanip.demos.loading import episode_table

    if not isinstance(dataset, dict):
        return None
    given = dataset.get("root")
    root = Path(str(given)) if given else HF_LEROBOT_HOME / str(dataset.get("repo_id"))
    if not (root / "meta" / "episodes").is_dir():
        return None
    try:
        return frozenset(map(str, episode_table(root)["object_id"].to_pylist()))
    except (OSError, ValueError, KeyError, RuntimeError):
        return None


def tell_training_objects(config: object, evaluated: Iterable[EnvironmentOptions]) -> None:
    """Logs, inside ``lerobot-eval``, how many of the objects the policy was trained on.

    Warns where it was trained on none of a category.
    """
    paths = [getattr(pipeline.policy, "pretrained_path", None) for pipeline in held_by_callers(config, EVALUATION)]
    known = trained_on(Path(paths[0])) if paths and paths[0] else None
    if known is None:
        return
    from lerobot_adamanip.catalog import select_objects

    for options in evaluated:
        if options.category not in known.categories:
            trained = ", ".join(sorted(known.categories))
            _logger.warning(
                "The policy was trained on %s, not on %s: it has seen none of the objects of this evaluation.",
                *(trained, options.category),
            )
        elif known.objects is not None:
            ids = select_objects(options.category, options.objects, options.assets)
            _logger.info(
                "%s: the policy was trained on %d of the %d objects of this evaluation (--env.objects=%s).",
                *(options.category, len(known.objects.intersection(ids)), len(ids), options.objects),
            )
