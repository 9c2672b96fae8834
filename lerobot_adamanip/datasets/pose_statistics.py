"""Statistics that leave rotation and gripper unscaled, for columns whose names are those of poses."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lerobot_adamanip.contract.schema import ACTION, ACTION_DIM, POSE_NAMES, STATE, Statistics, fix_pose_statistics
from lerobot_adamanip.datasets.dataset import MAX_STATISTICS_BYTES, Dataset
from lerobot_adamanip.datasets.opening import read_info
from lerobot_adamanip.datasets.statistics import plain_statistics
from lerobot_adamanip.hardware.features import names_of
from lerobot_adamanip.util import files
from lerobot_adamanip.util.json_fields import read


def unscaled_poses(stats: Statistics, features: Mapping[str, Any]) -> Statistics:
    """Returns dataset statistics with fixed ranges of rotation and gripper, see `schema.fix_pose_statistics`.

    Changes state and action if their names in ``features`` start with those of a pose.
    """
    poses = {
        key: stats[key]
        for key in (STATE, ACTION)
        if key in stats and names_of(features.get(key))[:ACTION_DIM] == list(POSE_NAMES)
    }
    return {**stats, **fix_pose_statistics(poses)}


def leave_poses_unscaled(root: Path | str) -> None:
    """Fixes the ranges of rotation and gripper in ``meta/stats.json``, for every training on this dataset. Idempotent.

    LeRobot builds a policy's normaliser from that file. `adamanip check` accepts fixed and measured ranges.

    Raises:
        OSError: there is no ``meta/stats.json`` or no ``meta/info.json``.
        ValueError: one of them is damaged.
    """
    path = Path(root) / "meta" / "stats.json"
    measured = read(path, MAX_STATISTICS_BYTES)
    plain = plain_statistics(unscaled_poses(measured, read_info(Path(root))["features"]))
    if plain != measured:
        files.write_atomically(path, (json.dumps(plain, indent=4) + "\n").encode())


def keep_unscaled_poses(out: Path, sources: Sequence[Dataset]) -> None:
    """Leaves the poses of a dataset unscaled if those of all ``sources`` are; see `leave_poses_unscaled`."""
    stored = [(read(one.root / "meta" / "stats.json", MAX_STATISTICS_BYTES), one.features) for one in sources]
    if all(plain_statistics(unscaled_poses(stats, features)) == stats for stats, features in stored):
        leave_poses_unscaled(out)
