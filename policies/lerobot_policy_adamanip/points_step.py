"""Clouds as points for policies of others: datasets and environments have them as rows of 3 N numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.configs.types import PipelineFeatureType, PolicyFeature
from lerobot.processor import ObservationProcessorStep

from lerobot_adamanip.pointcloud import as_points
from lerobot_adamanip.schema import POINT_CLOUD


@dataclass
class CloudToPointsStep(ObservationProcessorStep):
    """Views ``observation.point_cloud`` (B, ..., 3 N) as (B, ..., N, 3). The first step of a pipeline."""

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns an observation with points, if it has a cloud."""
        cloud = observation.get(POINT_CLOUD)
        return observation if cloud is None else {**observation, POINT_CLOUD: as_points(cloud)}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Features of the dataset stay as they are."""
        return features
