from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.nightly
def test_loading_the_policy_registers_the_steps_its_checkpoints_name() -> None:
    # In a process of its own, as lerobot-eval is: there nothing but the policy has been imported.
    code = (
        "import lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive\n"
        "from lerobot.processor import ProcessorStepRegistry as registry\n"
        "assert {'adamanip_rigid_augmentation', 'adamanip_orthonormalise'} <= set(registry.list())\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
