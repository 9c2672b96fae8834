"""The policies. Importing this registers configurations and processor steps; models are imported when needed."""

# LeRobot loads a checkpoint's processors by registered name before it imports the policy's processor file.
from lerobot_policy_adamanip.adaafford.configuration_adaafford import AdaAffordConfig
from lerobot_policy_adamanip.common import depth_to_cloud_step as depth_step
from lerobot_policy_adamanip.dp3_adaptive import processor_dp3_adaptive
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.sampling.configuration_sampling import SamplingConfig
from lerobot_policy_adamanip.vat_mart.configuration_vat_mart import VatMartConfig

__all__ = [
    "AdaAffordConfig",
    "DP3AdaptiveConfig",
    "SamplingConfig",
    "VatMartConfig",
    "depth_step",
    "processor_dp3_adaptive",
]
