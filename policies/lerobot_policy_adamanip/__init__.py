"""The policy ``dp3_adaptive``. Importing this registers its configuration; the model is imported on first use."""

from lerobot_policy_adamanip.configuration_dp3_adaptive import DP3AdaptiveConfig

__all__ = ["DP3AdaptiveConfig"]
