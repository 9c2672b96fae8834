"""What somebody without the simulator, or without anything to render with, gets to read."""

from __future__ import annotations

import pytest
from envs_helpers import NO_VULKAN, in_fresh_process

PLAIN = """
import json
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
said = []
env = KeyframeEnv("safe", num_points=64, image_size=64)
tasks = "lerobot_env_adamanip.sim.tasks"
for start in (lambda: env.reset(seed=0), lambda: env.reset(seed=0), lambda: __import__(tasks)):
    try:
        start()
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
def test_plain_maniskill_whose_observations_show_nothing_needs_no_vulkan_device() -> None:
    said = in_fresh_process(MANISKILL, **NO_VULKAN)
    assert said[0] == "ran"
    assert all("no Vulkan device" in each for each in said[1:])


@pytest.mark.parametrize("name", ["sapien", pytest.param("mani_skill", marks=pytest.mark.nightly)])
def test_without_the_simulator_the_extra_is_named(name: str) -> None:
    said = in_fresh_process(BLOCK.format(name=name) + PLAIN)
    assert len(said) == 3
    assert all(name in each and "lerobot_env_adamanip[sim]" in each for each in said)
