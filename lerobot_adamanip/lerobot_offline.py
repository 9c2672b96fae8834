"""Says which argument does, where LeRobot asks the Hub for versions and there is no Hub: for our datasets."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.errors import AdaManipError


def register(is_ours: Callable[[Mapping[str, Any]], bool]) -> None:
    """Adds that message to LeRobot's look-up of a dataset's versions, which stays as it is. Idempotent.

    Args:
        is_ours: tells it from a dataset's features.
    """
    from lerobot.datasets import dataset_metadata

    stock = dataset_metadata.get_safe_version
    if getattr(stock, "says_what_does", False):
        return

    def get_safe_version(repo_id: str, *arguments: Any, **options: Any) -> str:
        import httpx

        try:
            return str(stock(repo_id, *arguments, **options))
        except (ConnectionError, httpx.TransportError) as error:
            if commits := cached_commits(repo_id, is_ours):
                raise _unreachable(repo_id, commits) from error
            raise

    vars(get_safe_version)["says_what_does"] = True
    dataset_metadata.get_safe_version = get_safe_version


def cached_commits(repo_id: str, is_ours: Callable[[Mapping[str, Any]], bool]) -> list[str]:
    """Returns the commits of a dataset of ours that were pulled to this machine, the newest last."""
    from lerobot.utils.constants import HF_LEROBOT_HUB_CACHE

    folder = HF_LEROBOT_HUB_CACHE / f"datasets--{repo_id.replace('/', '--')}" / "snapshots"
    found = [path for path in folder.glob("*") if is_ours(_features(path / "meta" / "info.json"))]
    return [path.name for path in sorted(found, key=lambda path: path.stat().st_mtime)]


def _features(info: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(info.read_text(encoding="utf-8"))["features"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _unreachable(repo_id: str, commits: list[str]) -> AdaManipError:
    return AdaManipError(
        "LeRobot asks the Hub which versions of a dataset there are, and the Hub cannot be reached.",
        got=f"{repo_id} without a commit; pulled before: {', '.join(commits)}",
        allowed="a commit that was pulled, or a folder",
        hint=f"--dataset.revision={commits[-1]} (revision=... in Python), or --dataset.root=DIR",
    )
