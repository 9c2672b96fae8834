"""What somebody without the simulator, or without anything to render with, gets to read."""

from __future__ import annotations

import pytest
from envs_helpers import in_fresh_process

TRY = """
import json
from lerobot_adamanip.util.errors import SimulatorError
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
PLAIN = """
import json
from lerobot_adamanip.util.errors import SimulatorError
said = []
for module in ("lerobot_env_adamanip.tasks", "lerobot_env_adamanip.sim.tasks"):
    try:
        __import__(module)
    except SimulatorError as error:
        said.append(str(error))
print(json.dumps(said))
"""
MANISKILL = """
import json
import gymnasium as gym
import lerobot_env_adamanip.sim.tasks
from lerobot_adamanip.util.errors import SimulatorError
said = []
for options in ({"obs_mode": "state"}, {"obs_mode": "rgb"}, {"obs_mode": "state", "render_mode": "rgb_array"}):
    try:
        env = gym.make("AdaManip-Safe-v1", objects="0:4", control_mode="pd_joint_pos", **options)
        env.reset(seed=5)
        env.step(env.action_space.sample())
        env.close()
        said.append("ran")
    except SimulatorError as error:
        said.append(str(error))
print(json.dumps(said))
"""
NO_VULKAN = {"VK_ICD_FILENAMES": "/nonexistent/icd.json", "VK_DRIVER_FILES": "/nonexistent/icd.json"}
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
    said = in_fresh_process(TRY, **NO_VULKAN)
    assert len(said) == 2
    assert said[0] == said[1]
    assert "no Vulkan device" in said[0]
    assert "adamanip doctor" in said[0]
    assert "observe_images=False" in said[0]


@pytest.mark.sim
def test_plain_maniskill_whose_observations_show_nothing_needs_no_vulkan_device() -> None:
    said = in_fresh_process(MANISKILL, **NO_VULKAN)
    assert said[0] == "ran"
    assert all("no Vulkan device" in each for each in said[1:])


@pytest.mark.parametrize("code", [TRY, pytest.param(PLAIN, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", ["sapien", pytest.param("mani_skill", marks=pytest.mark.nightly)])
def test_without_the_simulator_the_extra_is_named(name: str, code: str) -> None:
    said = in_fresh_process(BLOCK.format(name=name) + code)
    assert len(said) == 2
    assert name in said[0]
    assert "lerobot_env_adamanip[sim]" in said[0]
