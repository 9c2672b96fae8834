"""Clouds and pictures: the same however they are made. ``scripts/check_clouds.py`` compares many scenes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import check_clouds
import gymnasium as gym
import numpy as np
import pytest
from envs_helpers import NO_VULKAN, at_once_or_at_night, in_fresh_process

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.observation import RepeatedPointsWarning, workspace_cloud
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, PAPER_NUM_POINTS
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim import renderer
from lerobot_env_adamanip.sim.ray_camera import Body
from lerobot_env_adamanip.sim.triangles import robot_triangles, shapes_triangles
from lerobot_env_adamanip.simulator import make_task

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def task() -> Iterator[Any]:
    made = make_task("coffee_maker", cloud_source="render")
    yield made
    made.close()


def test_rays_and_renderer_see_the_same(task: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = sum(check_clouds.views(task, 310, every=6), check_clouds.Counts())
    assert counts.views >= 2
    assert counts.pixels > 5000
    assert counts.off_1mm <= check_clouds.MOST_OFF * counts.pixels
    assert counts.off_2mm <= 3 * counts.views  # on the edges of what is seen, where a renderer rounds corners
    original = Body.pose

    def moved(body: Body) -> Any:
        pose = original(body)
        pose[0, 3] += 0.005
        return pose

    monkeypatch.setattr(Body, "pose", moved)
    assert not check_clouds.compare(task).passed, "half a centimetre is noticed"


def test_our_triangles_are_what_is_rendered(task: Any) -> None:
    """Link by link: the same corners and the same area, of object, plinth and arm."""
    task.reset(seed=310)
    ours = {body.entity.name: shapes_triangles(body.shapes) for body in task._objects.visible}
    looks = {entity.name: look for look, entity in task.views.depth_scene._looks}
    for name, triangles in {**ours, **robot_triangles(Path(task.agent.urdf_path))}.items():
        theirs = rendered_triangles(looks[name])
        assert len(theirs) >= len(triangles) > 0, name
        for edge in (np.min, np.max):
            np.testing.assert_allclose(edge(triangles, (0, 1)), edge(theirs, (0, 1)), atol=2e-6, err_msg=name)
        np.testing.assert_allclose(area(triangles), area(theirs), rtol=1e-4, err_msg=name)


def area(triangles: np.ndarray) -> float:
    sides = triangles.astype(np.float64)
    return float(np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1).sum() / 2)


def rendered_triangles(entity: Any) -> np.ndarray:
    """SAPIEN's triangles of an entity (N, 3, 3), in its frame: boxes and cylinders come as unit ones."""
    import sapien

    found = []
    for shape in entity.find_component_by_type(sapien.render.RenderBodyComponent).render_shapes:
        if isinstance(shape, sapien.render.RenderShapeTriangleMesh):
            parts = [(part.vertices * shape.scale, part.triangles) for part in shape.parts]
        else:
            size = {
                "RenderShapeBox": lambda s: s.half_size,
                "RenderShapeCylinder": lambda s: (s.half_length, s.radius, s.radius),
                "RenderShapeCapsule": lambda s: (1.0, 1.0, 1.0),
            }[type(shape).__name__](shape)
            parts = [(shape.get_vertices() * np.asarray(size), shape.get_triangles())]
        pose = shape.local_pose.to_transformation_matrix()
        found += [(corners @ pose[:3, :3].T + pose[:3, 3])[faces] for corners, faces in parts]
    return np.concatenate(found)


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
    seen, picture = wanted.any(2), task.observe().images["front"].astype(float)
    assert picture.std() > 10.0
    assert seen.mean() > 0.8
    assert np.abs(picture - wanted)[seen].mean() < 3.0


def test_resting_links_are_seen_as_if_they_were_cast_anew(envs: Callable[[str], KeyframeEnv]) -> None:
    env = envs("lamp")
    env.reset(seed=5)
    views = env._running().views
    first = views.points()
    views.set_joints(views.joints() + np.float32(0.02))
    moved = views.points()
    del views.rays
    np.testing.assert_array_equal(moved, views.points())
    assert first.shape != moved.shape or not np.array_equal(first, moved)


TRY = """
import json
import numpy as np
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
sizes = {"num_points": 128, "image_size": 64, "split": "test"}
env = KeyframeEnv("safe", observe_images=False, **sizes)
cloud = env.reset(seed=4)[0]["point_cloud"]
picture = env.render()
env.close()
said = []
for wanted in ({"observe_images": True}, {"observe_images": False, "cloud_source": "render"}):
    env = KeyframeEnv("safe", **sizes, **wanted)
    for _ in range(2):
        try:
            env.reset(seed=4)
        except SimulatorError as error:
            said.append(str(error))
    env.close()
print(json.dumps({"cloud": cloud.tolist(), "colors": len(np.unique(picture)), "said": said}))
"""


def test_without_a_vulkan_device_clouds_are_the_same_and_videos_are_shaded(envs: Callable[[str], KeyframeEnv]) -> None:
    told = in_fresh_process(TRY, **NO_VULKAN)
    np.testing.assert_array_equal(np.asarray(told["cloud"], np.float32), envs("safe").reset(seed=4)[0]["point_cloud"])
    assert told["colors"] > 20
    assert len(told["said"]) == 4
    for words in ("no Vulkan device", "adamanip doctor", "observe_images=False", "--no-images"):
        assert all(words in text for text in told["said"])


@at_once_or_at_night("category", CATEGORIES, ("pen",))
def test_no_point_of_a_cloud_comes_twice(envs: Callable[[str], KeyframeEnv], category: str) -> None:
    env = envs(category)
    env.reset(seed=7)
    views = env._running().views
    for wanted in (DEFAULT_NUM_POINTS, PAPER_NUM_POINTS):
        with warnings.catch_warnings():
            warnings.simplefilter("error", RepeatedPointsWarning)
            cloud = workspace_cloud(views.points(), DEFAULT_WORKSPACE, wanted)
        assert cloud.shape == (wanted, 3)
        assert DEFAULT_WORKSPACE.contains(cloud).all()
        # Two neighbouring pixels may round to one point, to a hundredth of a millimetre, once in thousands.
        assert len(np.unique(cloud, axis=0)) >= 0.995 * wanted
        vars(views).pop("rays")
        views.depth_size = 320  # as the paper's clouds have it


def test_the_size_of_pictures_changes_neither_the_cloud_nor_what_they_show(envs: Callable[[str], KeyframeEnv]) -> None:
    env = envs("pen")
    env.reset(seed=3)
    views = env._running().views
    seen = {}
    for size in (64, 400):
        views.image_size = size
        views._scenes.clear()
        camera = views.camera_parameters()
        assert (camera["width"], camera["height"]) == (size, size)
        assert camera["intrinsics"][0][2] == pytest.approx(size / 2)
        seen[size] = views.points(), views.image()
    assert np.array_equal(seen[64][0], seen[400][0])
    assert [image.shape for _, image in seen.values()] == [(64, 64, 3), (400, 400, 3)]
    small, large = (image.astype(float).mean((0, 1)) for _, image in seen.values())
    np.testing.assert_allclose(small, large, atol=2.0)


def test_missing_points_are_repeated_and_told() -> None:
    few = np.random.default_rng(0).uniform(0.5, 0.6, (40, 3)).astype(np.float32)
    with pytest.warns(RepeatedPointsWarning, match="fewer than num_points=64"):
        cloud = workspace_cloud(few, DEFAULT_WORKSPACE, 64)
    assert len(np.unique(cloud, axis=0)) <= 40
