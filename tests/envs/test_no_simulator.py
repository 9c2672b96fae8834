"""What somebody without the simulator, or without anything to render with, gets to read."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from envs_helpers import NO_VULKAN, in_fresh_process

from lerobot_adamanip.util.errors import INSTALL_SIM
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

PLAIN = """
import json, sys
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
said = []
made = AdaManipSafeEnvConfig(observe_images=False).create_envs(2)["adamanip_safe"][0]
env = KeyframeEnv("safe", num_points=64, image_size=64)
loaded = [name for name in ("sapien", "mani_skill") if name in sys.modules]
tasks = "lerobot_env_adamanip.sim.tasks"
for start in (lambda: env.reset(seed=0), lambda: env.reset(seed=0), lambda: __import__(tasks)):
    try:
        start()
    except SimulatorError as error:
        said.append(str(error))
print(json.dumps([said, made.num_envs, loaded]))
"""
WITHOUT_VULKAN = """
import json
import gymnasium as gym
import numpy as np
import lerobot_env_adamanip.sim.tasks
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
sizes = {"num_points": 128, "image_size": 64, "split": "test"}
env = KeyframeEnv("safe", observe_images=False, **sizes)
cloud = env.reset(seed=4)[0]["point_cloud"]
colors = len(np.unique(env.render()))
env.close()
def said(run):
    try:
        run()
        return "ran"
    except SimulatorError as error:
        return str(error)
def maniskill(**options):
    env = gym.make("AdaManip-Safe-v1", objects="0:4", control_mode="pd_joint_pos", **options)
    env.reset(seed=5)
    env.step(env.action_space.sample())
    env.close()
refused = []
for wanted in ({"observe_images": True}, {"observe_images": False, "cloud_source": "render"}):
    env = KeyframeEnv("safe", **sizes, **wanted)
    refused += [said(lambda: env.reset(seed=4)) for _ in range(2)]
    env.close()
plain = [said(lambda: maniskill(**options)) for options in (
    {"obs_mode": "state"}, {"obs_mode": "rgb"}, {"obs_mode": "state", "render_mode": "rgb_array"})]
print(json.dumps({"cloud": cloud.tolist(), "colors": colors, "refused": refused, "plain": plain}))
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
def test_without_a_vulkan_device_clouds_are_the_same_and_videos_are_shaded(envs: Callable[[str], KeyframeEnv]) -> None:
    """Nor does plain ManiSkill need one whose observations show nothing."""
    told = in_fresh_process(WITHOUT_VULKAN, **NO_VULKAN)
    np.testing.assert_array_equal(np.asarray(told["cloud"], np.float32), envs("safe").reset(seed=4)[0]["point_cloud"])
    assert told["colors"] > 20
    for words in ("no Vulkan device", "adamanip doctor", "observe_images=False", "--no-images"):
        assert [words in text for text in told["refused"]] == [True] * 4
    ran, *refused = told["plain"]
    assert ran == "ran"
    assert all("no Vulkan device" in text for text in refused)


@pytest.mark.parametrize("name", ["sapien", pytest.param("mani_skill", marks=pytest.mark.nightly)])
def test_without_the_simulator_the_extra_is_named(name: str) -> None:
    """When an episode begins: environments are made without it."""
    said, count, loaded = in_fresh_process(BLOCK.format(name=name) + PLAIN)
    assert (len(said), count, loaded) == (3, 2, [])
    assert all(name in each and INSTALL_SIM in each for each in said)
