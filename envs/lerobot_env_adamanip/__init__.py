"""AdaManip as a LeRobot plugin: importing this registers environments and policy, without heavy imports.

The environments are registered with Gymnasium too: ``gymnasium.make("AdaManipKeyframe-Safe-v0", objects="0:4")``, and
``AdaManipDense-Safe-v0`` at control rate.
If the variable `lerobot_adamanip.NO_PLUGIN` is set, it skips LeRobot's configurations, which take seconds to import.
"""

import os

import gymnasium

from lerobot_adamanip import NO_PLUGIN, __version__, lerobot_patches
from lerobot_adamanip.contract.categories import CATEGORIES

for category in CATEGORIES.values():
    for name, entry in (
        (category.keyframe_id, "lerobot_env_adamanip.keyframe_env:KeyframeEnv"),
        (category.dense_id, "lerobot_env_adamanip.dense_env:DenseEnv"),
    ):
        gymnasium.register(name, entry, kwargs={"category": category.name})

if not os.environ.get(NO_PLUGIN):
    from lerobot_adamanip.hardware import ON_CREATION
    from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
    from lerobot_adamanip.hardware.cameras.config_adamanip_realsense import AdamanipRealsenseConfig
    from lerobot_adamanip.hardware.teleoperators.config_devices import (
        AdamanipGamepadConfig,
        AdamanipKeyboardConfig,
        AdamanipSpacemouseConfig,
    )
    from lerobot_env_adamanip.config import (
        AdaManipBottleEnvConfig,
        AdaManipCoffeeMakerEnvConfig,
        AdaManipDoorEnvConfig,
        AdaManipEnvConfig,
        AdaManipLampEnvConfig,
        AdaManipMicrowaveEnvConfig,
        AdaManipPenEnvConfig,
        AdaManipPressureCookerEnvConfig,
        AdaManipSafeEnvConfig,
        AdaManipSuiteEnvConfig,
        AdaManipWindowEnvConfig,
    )
    from lerobot_env_adamanip.twin.config_devices import (
        AdamanipFrankaSimConfig,
        AdamanipScriptedConfig,
        AdamanipTwinConfig,
    )
    from lerobot_policy_adamanip.adaafford.configuration_adaafford import AdaAffordConfig
    from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
    from lerobot_policy_adamanip.sampling.configuration_sampling import SamplingConfig
    from lerobot_policy_adamanip.vat_mart.configuration_vat_mart import VatMartConfig

    ON_CREATION.append(lerobot_patches.apply)

__all__ = [
    "AdaAffordConfig", "AdaManipBottleEnvConfig", "AdaManipCoffeeMakerEnvConfig", "AdaManipDoorEnvConfig",
    "AdaManipEnvConfig", "AdaManipLampEnvConfig", "AdaManipMicrowaveEnvConfig", "AdaManipPenEnvConfig",
    "AdaManipPressureCookerEnvConfig", "AdaManipSafeEnvConfig", "AdaManipSuiteEnvConfig", "AdaManipWindowEnvConfig",
    "AdamanipFrankaConfig", "AdamanipFrankaSimConfig", "AdamanipGamepadConfig", "AdamanipKeyboardConfig",
    "AdamanipRealsenseConfig", "AdamanipScriptedConfig", "AdamanipSpacemouseConfig", "AdamanipTwinConfig",
    "DP3AdaptiveConfig", "SamplingConfig", "VatMartConfig", "__version__",
]  # fmt: skip
