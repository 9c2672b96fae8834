"""Every line that changes LeRobot: three patches, one file each, all for recordings of our robots.

The plugin has them applied when a robot of ours is created. Importing this package or the plugin changes nothing, and
the order of imports does not matter. A patch changes a module of LeRobot only if that is loaded. It tests what it
changes, and turns itself off with one line in the log where LeRobot is different. `NO_PATCHES` turns all of them off.
"""

from __future__ import annotations

import logging
import os

from lerobot_adamanip.lerobot_patches import support
from lerobot_adamanip.lerobot_patches.support import UnsupportedError

__all__ = ["NO_PATCHES", "PATCHES", "apply", "restore"]
NO_PATCHES = "ADAMANIP_NO_PATCHES"
"""Environment variable: set to 1, LeRobot stays as it is."""
PATCHES = {
    "durable_recording": (
        "lerobot.datasets.lerobot_dataset",
        "A kill loses every episode of a recording session, and the robot's calibrations are not kept beside it.",
    ),
    "ordered_depth": (
        "lerobot.datasets.lerobot_dataset",
        "A recording session with depth may end with an error at an episode of one or two frames.",
    ),
    "episode_signals": (
        "lerobot.scripts.lerobot_record",
        "The twin keeps its scene between episodes, no teleoperator ends one, and the clutch alone anchors goals.",
    ),
}
"""Patch -> the module of LeRobot that it changes, and what a user loses without it."""
_log = logging.getLogger(__name__)
_on: set[str] = set()
_warned: set[str] = set()


def apply() -> None:
    """Applies each patch whose module of LeRobot is loaded. Idempotent.

    A script that records a robot of its own with our columns calls this after its imports.
    """
    if os.environ.get(NO_PATCHES, "") not in ("", "0"):
        losses = " ".join(loss for _, loss in PATCHES.values())
        _warn_once(f"{NO_PATCHES} is set, so LeRobot stays as it is. {losses}")
        return
    for name, (changed, loss) in PATCHES.items():
        if name in _on or support.loaded(changed) is None:
            continue
        before = support.count()
        try:
            _apply(name)
            _on.add(name)
        except (UnsupportedError, ImportError) as error:
            support.restore(before)
            _warn_once(f"The patch {name} does not fit this LeRobot ({error}) and is off. {loss}")


def restore() -> None:
    """Takes all patches back: for comparison with LeRobot as it is."""
    support.restore()
    _on.clear()
    _warned.clear()


def _apply(name: str) -> None:
    if name == "durable_recording":
        from lerobot_adamanip.lerobot_patches.durable_recording import apply as patch
    elif name == "ordered_depth":
        from lerobot_adamanip.lerobot_patches.ordered_depth import apply as patch
    else:
        from lerobot_adamanip.lerobot_patches.episode_signals import apply as patch
    patch()


def _warn_once(line: str) -> None:
    if line not in _warned:
        _warned.add(line)
        _log.warning(line)
