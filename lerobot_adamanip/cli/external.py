"""External assets on the command line: those that can be loaded, and that the simulated arm reaches."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable
from pathlib import Path

from lerobot_adamanip.assets import AssetSource
from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.util.errors import SimulatorError


def select_placeable(categories: Iterable[str], selection: str, assets: Path | None, poses: str) -> tuple[str, ...]:
    """Returns ids of objects, see `select_objects`; external assets that the arm cannot reach are left out."""
    placeable = None
    if assets is not None:
        from lerobot_env_adamanip.simulator import placement_check

        placeable = placement_check(poses)
    return tuple(name for each in categories for name in select_objects(each, selection, assets, placeable))


def checked_source(assets: Path) -> AssetSource:
    """Returns the assets of a folder; what the arm cannot reach is unusable, if the simulator is here to tell."""
    from lerobot_env_adamanip.simulator import placement_check

    try:
        with contextlib.redirect_stdout(sys.stderr):  # what the simulator prints must not get into the JSON
            return AssetSource(assets, placement_check())
    except SimulatorError:
        print("not checked without the simulator: whether the arm reaches the objects", file=sys.stderr)
        return AssetSource(assets)
