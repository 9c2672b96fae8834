"""Processors of ``vat_mart``: LeRobot's own steps, and clouds from depth. LeRobot finds them by this name."""

from lerobot_policy_adamanip.common.depth_to_cloud_step import (
    make_pipelines_with_depth as make_vat_mart_pre_post_processors,
)

__all__ = ["make_vat_mart_pre_post_processors"]
