"""Pre- and post-processing of ``adaafford``: LeRobot's own steps; nothing is normalised."""

from __future__ import annotations

from lerobot.processor import make_default_pre_post_processors
from torch import Tensor

from lerobot_policy_adamanip.adaafford.configuration_adaafford import AdaAffordConfig
from lerobot_policy_adamanip.contract import Pipelines


def make_adaafford_pre_post_processors(
    config: AdaAffordConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> Pipelines:
    """Returns the pipelines around the policy. LeRobot finds this by its name."""
    pipelines: Pipelines = make_default_pre_post_processors(config, dataset_stats)
    return pipelines
