"""Processor step for other projects' policies: reshapes flat clouds, 3 N numbers, to points (N, 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.configs.types import PipelineFeatureType, PolicyFeature
from lerobot.processor import ObservationProcessorStep

from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import POINT_CLOUD

_CLOUDS = (POINT_CLOUD, "observation.pointcloud")
"""This project's name, and LeRobot's."""


@dataclass
class CloudToPointsStep(ObservationProcessorStep):
    """Views a cloud (B, ..., 3 N) as (B, ..., N, 3), under our or LeRobot's key. First step of a pipeline."""

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation, with its cloud reshaped if there is one."""
        clouds = {key: as_points(observation[key]) for key in _CLOUDS if key in observation}
        return {**observation, **clouds}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Returns the features unchanged."""
        return features
