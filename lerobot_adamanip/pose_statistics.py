"""Statistics that leave rotation and gripper unscaled, for the columns that hold poses by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.schema import ACTION, ACTION_DIM, POSE_NAMES, STATE, Statistics, fix_pose_statistics


def flat_names(feature: Mapping[str, Any] | None) -> list[str]:
    """Returns the names of a feature's numbers, which LeRobot keeps as a list or in groups; [] for none."""
    names = (feature or {}).get("names")
    return [name for group in names.values() for name in group] if isinstance(names, Mapping) else list(names or ())


def unscaled_poses(stats: Statistics, features: Mapping[str, Any]) -> Statistics:
    """Returns dataset statistics with fixed ranges of rotation and gripper, see `schema.fix_pose_statistics`.

    Args:
        stats: of the dataset.
        features: of the dataset. State and action change where their names begin with those of a pose.
    """
    poses = {
        key: stats[key]
        for key in (STATE, ACTION)
        if key in stats and flat_names(features.get(key))[:ACTION_DIM] == list(POSE_NAMES)
    }
    return {**stats, **fix_pose_statistics(poses)}
