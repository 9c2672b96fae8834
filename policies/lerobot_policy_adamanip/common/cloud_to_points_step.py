"""Processor step that gives clouds, stored as rows of 3 N numbers, their points for policies of others."""

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
    """Views a cloud (B, ..., 3 N) as (B, ..., N, 3), before or after LeRobot renamed it; a pipeline's first step."""

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns an observation with points, if it has a cloud."""
        clouds = {key: as_points(observation[key]) for key in _CLOUDS if key in observation}
        return {**observation, **clouds}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Features stay."""
        return features
