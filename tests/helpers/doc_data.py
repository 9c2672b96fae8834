"""What documents and examples work on, made without a simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def collect_fake_demos(root: Path, **changes: Any) -> None:
    """A dataset of the same columns as a real one; ``changes`` are those of `demos_helpers.make_spec`."""
    from demos_helpers import fakes, make_spec, patiently

    from lerobot_adamanip.collection.collect import collect

    root.parent.mkdir()
    collect(root, make_spec(**changes), fakes(), patiently())


def write_asset_safe(folder: Path) -> None:
    """A small object in AdaManip's layout."""
    from asset_folders import adamanip_safe

    adamanip_safe(folder)
