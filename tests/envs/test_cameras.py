"""The two cameras: where they look from, from which source, and that equal states give equal bytes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from envs_helpers import NO_VULKAN, SMALL, digest, grasp_handle

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT, HAND, WRIST
from lerobot_env_adamanip.dense_env import DenseEnv
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim
SEED = 3
WITHOUT_VULKAN = """
import sys
from envs_helpers import SMALL, digest
from lerobot_env_adamanip.dense_env import DenseEnv
env = DenseEnv("safe", **SMALL)
print(digest(env.reset(seed=int(sys.argv[1]))[0]))
try:
    DenseEnv("safe", **SMALL, image_source="render", observe_images=True).reset(seed=0)
except Exception as error:
    print(type(error).__name__, "--env.image_source=raycast" in str(error))
"""


def test_the_front_camera_rests_and_the_wrist_camera_follows_the_hand(envs: Callable[[str], KeyframeEnv]) -> None:
    env = envs("safe")
    env.reset(seed=SEED)
    cameras: Any = env.episode.task.cameras
    hand, before = cameras.mount(WRIST), {name: (cameras.view(name), cameras.raycast_image(name)) for name in CAMERAS}
    assert cameras.mount(FRONT) is None
    assert hand.name == HAND
    in_hand = np.linalg.inv(hand.pose.to_transformation_matrix()) @ before[WRIST][0].pose
    grasp_handle(env)
    np.testing.assert_array_equal(cameras.view(FRONT).pose, before[FRONT][0].pose)
    moved = hand.pose.to_transformation_matrix() @ in_hand
    np.testing.assert_allclose(cameras.view(WRIST).pose, moved, atol=1e-5)
    assert np.linalg.norm(moved[:3, 3] - before[WRIST][0].pose[:3, 3]) > 0.1
    assert (
        (cameras.raycast_image(FRONT) != before[FRONT][1]).mean()
        < 0.4
        < (cameras.raycast_image(WRIST) != before[WRIST][1]).mean()
    )


def test_the_wrist_camera_looks_at_what_the_fingers_hold(envs: Callable[[str], KeyframeEnv]) -> None:
    """The tool's centre lies in the lower half of the image, in the middle between the fingers."""
    env = envs("safe")
    env.reset(seed=SEED)
    cameras: Any = env.episode.task.cameras
    size, view = env.options.image_size, cameras.view(WRIST)
    x, y, z = (view.world_to_camera @ env.feedback.tcp_in_base)[:3, 3]
    assert size / 2 - view.focal * x / z == pytest.approx(size / 2, abs=size / 10)
    assert 0.6 * size < size / 2 + view.focal * y / z < 0.95 * size


def test_the_wrist_camera_is_drawn_after_the_front_camera() -> None:
    from lerobot_env_adamanip.sim.scene import draw_cameras

    poses, rng = draw_cameras(np.random.default_rng(1), 0.03), np.random.default_rng(1)
    np.testing.assert_allclose(poses[FRONT].p, CAMERAS[FRONT].eye + rng.uniform(-0.03, 0.03, 3), atol=1e-6)
    assert 0 < np.abs(poses[WRIST].p - CAMERAS[WRIST].eye).max() < 0.0031


def test_both_cameras_need_no_renderer_and_are_equal_in_each_process() -> None:
    env = DenseEnv("safe", **SMALL)
    observation, _ = env.reset(seed=SEED)
    assert set(observation["pixels"]) == {FRONT, WRIST}
    cameras: Any = env.episode.task.cameras
    for name, image in observation["pixels"].items():
        np.testing.assert_array_equal(image, cameras.image(name))
    env.close()
    line = [sys.executable, "-c", WITHOUT_VULKAN, str(SEED)]
    environment = {**os.environ, **NO_VULKAN, "PYTHONPATH": os.pathsep.join(sys.path)}
    said = subprocess.run(line, capture_output=True, text=True, check=True, env=environment).stdout
    assert said.splitlines()[-2:] == [digest(observation), "SimulatorError True"]
