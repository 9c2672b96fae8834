"""Clouds of every category are of as many points as they say, at the sizes that are used, whatever the image's size."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from envs_helpers import OneSimulator

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.observation import RepeatedPointsWarning, workspace_cloud
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, PAPER_NUM_POINTS
from lerobot_env_adamanip.keyframe_env import make_task

pytestmark = pytest.mark.sim


@pytest.mark.parametrize("category", CATEGORIES)
def test_no_point_of_a_cloud_comes_twice(simulator: OneSimulator, category: str) -> None:
    task = simulator.get(category, lambda: make_task(category))
    task.reset(seed=7)
    points = task.observe(image=False).points_in_base
    for wanted in (DEFAULT_NUM_POINTS, PAPER_NUM_POINTS):
        with warnings.catch_warnings():
            warnings.simplefilter("error", RepeatedPointsWarning)
            cloud = workspace_cloud(points, DEFAULT_WORKSPACE, wanted)
        assert cloud.shape == (wanted, 3)
        assert DEFAULT_WORKSPACE.contains(cloud).all()
        # Two neighbouring pixels may round to one point, to a hundredth of a millimetre, once in thousands.
        assert len(np.unique(cloud, axis=0)) >= 0.995 * wanted


def _observed(size: int, *, image: bool) -> Any:
    task = make_task("pen", image_size=size)
    try:
        task.reset(seed=3)
        parameters = task.views.camera_parameters()
        assert (parameters.width, parameters.height) == (size, size)
        assert parameters.intrinsics[0, 2] == pytest.approx(size / 2)
        return task.observe(image=image)
    finally:
        task.close()


def test_the_cloud_does_not_depend_on_the_images_size() -> None:
    seen = [_observed(size, image=False) for size in (64, 256, 400)]
    assert all(np.array_equal(each.points_in_base, seen[0].points_in_base) for each in seen)


def test_images_of_any_size_show_the_same() -> None:
    small, large = (_observed(size, image=True).image for size in (64, 400))
    assert (small.shape, large.shape) == ((64, 64, 3), (400, 400, 3))
    small, large = (image.astype(float).mean((0, 1)) for image in (small, large))
    np.testing.assert_allclose(small, large, atol=2.0)


def test_points_that_are_not_there_are_repeated_and_told() -> None:
    few = np.random.default_rng(0).uniform(0.5, 0.6, (40, 3)).astype(np.float32)
    with pytest.warns(RepeatedPointsWarning, match="fewer than num_points=64"):
        cloud = workspace_cloud(few, DEFAULT_WORKSPACE, 64)
    assert len(np.unique(cloud, axis=0)) <= 40
