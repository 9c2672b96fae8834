"""Import errors for modules that moved in version 0.3; the error names the new module."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
from collections.abc import Sequence
from types import ModuleType

MOVED = {
    "categories": "contract.categories", "demos": "collection, datasets and recordings", "errors": "util.errors",
    "files": "util.files", "fingerprint": "util.fingerprint", "hub.check": "datasets.check", "jobs": "util.jobs",
    "keyframes": "contract.keyframes", "observation": "contract.observation", "options": "episode.options",
    "pointcloud": "contract.pointcloud", "pose_statistics": "datasets.pose_statistics", "rollout": "episode.rollout",
    "rotations": "contract.rotations", "schema": "contract.schema", "seeds": "contract.seeds",
    "trained_policy": "collection.trained_policy",
}  # fmt: skip
"""Name below `lerobot_adamanip` until version 0.2 -> new name."""


class MovedModules(importlib.abc.MetaPathFinder):
    """Raises for moved modules; finds no module itself. It runs after the other finders."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Raises `ModuleNotFoundError` for an old name; returns None for any other."""
        package, _, name = fullname.partition(".")
        if package == "lerobot_adamanip" and name in MOVED:
            raise ModuleNotFoundError(f"{fullname} has moved: import lerobot_adamanip.{MOVED[name]}", name=fullname)
        return None
