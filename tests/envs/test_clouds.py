"""Clouds and pictures: the same however they are made."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import rays_and_renderer
from check_common import check_scenes
from envs_helpers import at_once_or_at_night

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.observation import RepeatedPointsWarning, workspace_cloud
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, PAPER_NUM_POINTS
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim import renderer
from lerobot_env_adamanip.sim.raycast import Body
from lerobot_env_adamanip.simulator import make_task

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def task() -> Iterator[Any]:
    made = make_task("coffee_maker", cloud_source="render", num_points=PAPER_NUM_POINTS)
    yield made
    made.close()


def test_rays_and_renderer_see_the_same(task: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = sum(rays_and_renderer.views(task, 310, every=6), rays_and_renderer.Counts())
    assert counts.views >= 2
    assert counts.pixels > 5000
    assert counts.off_1mm <= rays_and_renderer.MOST_OFF * counts.pixels
    assert counts.off_2mm <= 3 * counts.views  # on the edges of what is seen, where a renderer rounds corners
    original = Body.pose

    def moved(body: Body) -> Any:
        pose = original(body)
        pose[0, 3] += 0.005
        return pose

    monkeypatch.setattr(Body, "pose", moved)
    assert not rays_and_renderer.compare(task).passed, "half a centimetre is noticed"


@pytest.mark.nightly
@pytest.mark.parametrize("category", CATEGORIES)
def test_rays_and_renderer_see_the_same_in_every_category(category: str) -> None:
    def compare(task: Any, seed: int) -> rays_and_renderer.Counts:
        return sum(rays_and_renderer.views(task, seed, every=4), rays_and_renderer.Counts())

    options = {"cloud_source": "render", "num_points": PAPER_NUM_POINTS}
    counts = sum(check_scenes(category, range(300, 305), compare, task_options=options), rays_and_renderer.Counts())
    assert counts.views >= 5
    assert counts.passed, counts


def test_pictures_are_those_of_plain_maniskill(task: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the shaders as SAPIEN has them, all links drawn, and black where nothing is seen."""
    monkeypatch.setattr(renderer, "_unlit_pack", lambda: None)
    plain: Any = gym.make("AdaManip-CoffeeMaker-v1", obs_mode="rgb", shader="minimal").unwrapped
    try:
        observed, _ = plain.reset(seed=311)
        wanted = observed["sensor_data"]["front"]["rgb"][0].cpu().numpy()
    finally:
        plain.close()
    monkeypatch.undo()
    assert renderer._unlit_pack() is not None, "this SAPIEN's shaders are written as we expect"
    task.reset(seed=311)
    seen, picture = wanted.any(2), task.cameras.image().astype(float)
    assert picture.std() > 10.0
    assert seen.mean() > 0.8
    assert np.abs(picture - wanted)[seen].mean() < 3.0


def test_resting_links_are_seen_as_if_they_were_cast_anew(envs: Callable[[str], KeyframeEnv]) -> None:
    env = envs("lamp")
    env.reset(seed=5)
    cameras, simulation = env.episode.task.cameras, env.episode.task.simulation
    first = cameras.points()
    simulation.set_joints(simulation.joints() + np.float32(0.02))
    moved = cameras.points()
    del cameras.rays
    np.testing.assert_array_equal(moved, cameras.points())
    assert first.shape != moved.shape or not np.array_equal(first, moved)


@at_once_or_at_night("category", CATEGORIES, ("pen",))
def test_no_point_of_a_cloud_comes_twice(envs: Callable[[str], KeyframeEnv], category: str) -> None:
    env = envs(category)
    env.reset(seed=7)
    cameras = env.episode.task.cameras
    for wanted in (DEFAULT_NUM_POINTS, PAPER_NUM_POINTS):
        sized = replace(cameras, options=cameras.options.changed(num_points=wanted))
        with warnings.catch_warnings():
            warnings.simplefilter("error", RepeatedPointsWarning)
            cloud = workspace_cloud(sized.points(), DEFAULT_WORKSPACE, wanted)
        assert cloud.shape == (wanted, 3)
        assert DEFAULT_WORKSPACE.contains(cloud).all()
        # Two neighbouring pixels may round to one point, to a hundredth of a millimetre, once in thousands.
        assert len(np.unique(cloud, axis=0)) >= 0.995 * wanted


def test_missing_points_are_repeated_and_told() -> None:
    few = np.random.default_rng(0).uniform(0.5, 0.6, (40, 3)).astype(np.float32)
    with pytest.warns(RepeatedPointsWarning, match="fewer than num_points=64"):
        cloud = workspace_cloud(few, DEFAULT_WORKSPACE, 64)
    assert len(np.unique(cloud, axis=0)) <= 40
