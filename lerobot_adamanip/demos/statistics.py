"""The statistics of a finished dataset: ``meta/stats.json``."""

from __future__ import annotations

from pathlib import Path

from lerobot_adamanip.errors import DatasetError


def sort_statistics(root: Path) -> None:
    """Sorts the statistics that LeRobot wrote by column: its order changes from run to run. Their values stay.

    Raises:
        DatasetError: LeRobot wrote none.
    """
    from lerobot.datasets.io_utils import load_stats, write_stats

    stats = load_stats(root)
    if stats is None:
        raise DatasetError(
            "LeRobot wrote no statistics.", got=root / "meta", allowed="meta/stats.json", hint="lerobot 0.6.1"
        )
    write_stats(dict(sorted(stats.items())), root)
