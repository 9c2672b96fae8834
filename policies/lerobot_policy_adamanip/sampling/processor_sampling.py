"""Pre- and post-processing of ``sampling``: LeRobot's own steps; nothing is normalised."""

from __future__ import annotations

from lerobot.processor import make_default_pre_post_processors
from torch import Tensor

from lerobot_policy_adamanip.contract import Pipelines
from lerobot_policy_adamanip.sampling.configuration_sampling import SamplingConfig


def make_sampling_pre_post_processors(
    config: SamplingConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> Pipelines:
    """Returns the pipelines around the policy. LeRobot finds this by its name."""
    pipelines: Pipelines = make_default_pre_post_processors(config, dataset_stats)
    return pipelines
