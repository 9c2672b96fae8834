"""Processors of ``vat_mart``: LeRobot's own steps, and clouds from depth. LeRobot finds them by this name."""

from lerobot_policy_adamanip.common import depth_to_cloud_step

make_vat_mart_pre_post_processors = depth_to_cloud_step.make_pipelines_with_depth
