"""What somebody without the simulator, or without anything to render with, gets to read."""

from __future__ import annotations

import pytest
from envs_helpers import in_fresh_process

TRY = """
import json
from lerobot_adamanip.errors import SimulatorError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
env, said = KeyframeEnv("safe", num_points=64, image_size=64), []
for _ in range(2):
    try:
        env.reset(seed=0)
    except SimulatorError as error:
        said.append(str(error))
env.close()
print(json.dumps(said))
"""
BLOCK = """
import sys
class Block:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] == {name!r}:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)
sys.meta_path.insert(0, Block)
"""


@pytest.mark.sim
def test_without_a_vulkan_device_the_doctor_is_recommended() -> None:
    missing = "/nonexistent/icd.json"
    said = in_fresh_process(TRY, VK_ICD_FILENAMES=missing, VK_DRIVER_FILES=missing)
    assert len(said) == 2
    assert said[0] == said[1]
    assert "no Vulkan device" in said[0]
    assert "adamanip doctor" in said[0]


@pytest.mark.parametrize("name", ["sapien", pytest.param("mani_skill", marks=pytest.mark.nightly)])
def test_without_the_simulator_the_extra_is_named(name: str) -> None:
    said = in_fresh_process(BLOCK.format(name=name) + TRY)
    assert len(said) == 2
    assert name in said[0]
    assert "lerobot_env_adamanip[sim]" in said[0]
