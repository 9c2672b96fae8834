"""All patches of LeRobot, one per file: four for our robots, one for training speed.

Creating one of our robots applies the four in `PATCHES`. Our policies apply `batched_reading` to their training
dataset. Importing this package or the plugin changes nothing, and the import order does not matter. A patch changes
only loaded modules of LeRobot. It tests the code it changes. If LeRobot differs, it logs one line and stays off. The
variable `NO_PATCHES` turns all patches off.
"""

from __future__ import annotations

import importlib

from lerobot_adamanip.lerobot_patches import support
from lerobot_adamanip.lerobot_patches.support import NO_PATCHES, UnsupportedError, warn_once

__all__ = ["NO_PATCHES", "PATCHES", "apply", "restore"]
PATCHES = {
    "durable_recording": (
        "lerobot.datasets.lerobot_dataset",
        "A kill loses every episode of a recording session; recordings lack the arm's readings and calibrations.",
    ),
    "ordered_depth": (
        "lerobot.datasets.lerobot_dataset",
        "A recording session with depth may end with an error at an episode of one or two frames.",
    ),
    "rollout_memory": (
        "lerobot.rollout.context",
        "A policy that was trained with --memory events fails on a robot at its first observation.",
    ),
    "episode_signals": (
        "lerobot.scripts.lerobot_record",
        "The twin keeps its scene between episodes, no teleoperator ends one, and only the clutch anchors goals.",
    ),
}
"""Patch -> LeRobot module that it changes, and the loss without it."""
_on: set[str] = set()


def apply() -> None:
    """Applies each patch whose LeRobot module is loaded. Idempotent.

    A script that records its own robot with our columns calls this after its imports.
    """
    if support.are_off(" ".join(loss for _, loss in PATCHES.values())):
        return
    for name, (changed, loss) in PATCHES.items():
        if name in _on or support.loaded(changed) is None:
            continue
        before = support.count()
        try:
            importlib.import_module(f"lerobot_adamanip.lerobot_patches.{name}").apply()
            _on.add(name)
        except (UnsupportedError, ImportError, AttributeError, KeyError) as error:
            support.restore(before)
            warn_once(f"The patch {name} does not fit this LeRobot ({error}) and is off. {loss}")


def restore() -> None:
    """Removes all patches, for comparison with unpatched LeRobot."""
    support.restore()
    _on.clear()
