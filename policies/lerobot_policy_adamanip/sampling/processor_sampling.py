"""Processors of ``sampling``: LeRobot's own steps, and clouds from depth. LeRobot finds them by this name."""

from lerobot_policy_adamanip.common.depth_to_cloud_step import (
    make_pipelines_with_depth as make_sampling_pre_post_processors,
)

__all__ = ["make_sampling_pre_post_processors"]
