"""Processor step for other projects' policies: reshapes flat clouds, 3 N numbers, to points (N, 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.processor import ObservationProcessorStep

from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_policy_adamanip.common.depth_to_cloud_step import SameFeaturesStep

_CLOUDS = (POINT_CLOUD, "observation.pointcloud")
"""This project's name, and LeRobot's."""


@dataclass
class CloudToPointsStep(SameFeaturesStep, ObservationProcessorStep):
    """Views a cloud (B, ..., 3 N) as (B, ..., N, 3), under our or LeRobot's key. First step of a pipeline."""

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation, with its cloud reshaped if there is one."""
        clouds = {key: as_points(observation[key]) for key in _CLOUDS if key in observation}
        return {**observation, **clouds}
