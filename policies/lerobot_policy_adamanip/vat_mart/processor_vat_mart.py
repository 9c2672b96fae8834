"""Pre- and post-processing of ``vat_mart``: LeRobot's own steps; nothing is normalised."""

from __future__ import annotations

from lerobot.processor import make_default_pre_post_processors
from torch import Tensor

from lerobot_policy_adamanip.contract import Pipelines
from lerobot_policy_adamanip.vat_mart.configuration_vat_mart import VatMartConfig


def make_vat_mart_pre_post_processors(
    config: VatMartConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> Pipelines:
    """Returns the pipelines around the policy. LeRobot finds this by its name."""
    pipelines: Pipelines = make_default_pre_post_processors(config, dataset_stats)
    return pipelines
