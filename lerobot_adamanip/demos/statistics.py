"""A dataset's statistics, as our datasets have them."""

from __future__ import annotations

from pathlib import Path

from lerobot_adamanip import schema
from lerobot_adamanip.errors import DatasetError


def fix_statistics(root: Path) -> None:
    """Rewrites the statistics that LeRobot wrote for a dataset: known ranges of poses (`schema.fix_pose_statistics`).

    Raises:
        DatasetError: LeRobot wrote none.
    """
    from lerobot.datasets.io_utils import load_stats, write_stats

    stats = load_stats(root)
    if stats is None:
        raise DatasetError(
            "LeRobot wrote no statistics.", got=root / "meta", allowed="meta/stats.json", hint="lerobot 0.6.1"
        )
    # Sorted, because LeRobot's order changes from run to run.
    write_stats(dict(sorted(schema.fix_pose_statistics(stats).items())), root)
