"""Pre- and post-processing of ``vat_mart``: LeRobot's own steps, and clouds from depth; nothing is normalised."""

from __future__ import annotations

from torch import Tensor

from lerobot_policy_adamanip.common.contract import Pipelines
from lerobot_policy_adamanip.common.depth_to_cloud_step import make_pipelines_with_depth
from lerobot_policy_adamanip.vat_mart.configuration_vat_mart import VatMartConfig


def make_vat_mart_pre_post_processors(
    config: VatMartConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> Pipelines:
    """Returns the pipelines around the policy. LeRobot finds this by its name."""
    return make_pipelines_with_depth(config, config.num_points, dataset_stats)
