"""The policy ``dp3_adaptive``. Importing this registers configuration and processor steps; the model comes later."""

# LeRobot loads a checkpoint's processors by registered name before it imports the policy's processor file.
from lerobot_policy_adamanip.dp3_adaptive import processor_dp3_adaptive
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig

__all__ = ["DP3AdaptiveConfig", "processor_dp3_adaptive"]
