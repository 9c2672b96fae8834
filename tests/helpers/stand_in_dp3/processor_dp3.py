"""Processors of the stand-in: LeRobot's usual ones. A cloud that has to be made of depth is none of ours."""

from __future__ import annotations

from lerobot_policy_stand_in.configuration_dp3 import DP3Config


def make_dp3_pre_post_processors(config: DP3Config, dataset_stats=None):
    """LeRobot finds this by its name."""
    from lerobot.policies.diffusion.processor_diffusion import make_diffusion_pre_post_processors

    assert not config.pointcloud_from_depth
    return make_diffusion_pre_post_processors(config, dataset_stats)
