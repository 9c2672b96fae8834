"""AdaManip as a LeRobot plugin: importing this registers environments and policy, and nothing heavy."""

from lerobot_env_adamanip.config import AdaManipEnvConfig, AdaManipSafeEnvConfig
from lerobot_policy_adamanip.configuration_dp3_adaptive import DP3AdaptiveConfig

__all__ = ["AdaManipEnvConfig", "AdaManipSafeEnvConfig", "DP3AdaptiveConfig"]
