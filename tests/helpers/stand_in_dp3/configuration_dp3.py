"""Configuration of the stand-in."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig


@PreTrainedConfig.register_subclass("dp3")
@dataclass
class DP3Config(DiffusionConfig):
    """Options that docs/lerobot_policies.md gives it, and those of LeRobot's diffusion policy."""

    pointcloud_num_points: int = 1024
    pointcloud_from_depth: bool = True

    def validate_features(self) -> None:
        """Wants a state; pictures are optional."""
        if self.robot_state_feature is None:
            raise ValueError("observation.state is missing")
