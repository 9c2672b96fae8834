"""Clouds and pictures are the same however they are made. The full run: ``scripts/check_clouds.py``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import check_clouds
import numpy as np
import pytest
from envs_helpers import in_fresh_process

from lerobot_env_adamanip.keyframe_env import KeyframeEnv, make_task
from lerobot_env_adamanip.sim import rendering

pytestmark = pytest.mark.sim
NO_VULKAN = {"VK_ICD_FILENAMES": "/nonexistent.json", "VK_DRIVER_FILES": "/nonexistent.json"}


@pytest.fixture(scope="module", params=[pytest.param("coffee_maker", marks=pytest.mark.nightly), "safe"])
def task(request: pytest.FixtureRequest) -> Any:
    task = make_task(request.param, cloud_source="render")
    yield task
    task.close()


def test_rays_and_renderer_see_the_same(task: Any) -> None:
    counts = sum(check_clouds.views(task, 310, every=6), check_clouds.Counts())
    assert counts.views >= 2
    assert counts.pixels > 5000
    assert counts.off_1mm <= check_clouds.MOST_OFF * counts.pixels
    assert counts.off_2mm <= 3 * counts.views  # on the edges of what is seen, where a renderer rounds corners


def test_the_comparison_notices_what_is_half_a_centimetre_off(task: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot_env_adamanip.sim.sensors import Body

    task.reset(seed=310)
    original = Body.pose

    def moved(body: Body) -> Any:
        pose = original(body)
        pose[0, 3] += 0.005
        return pose

    monkeypatch.setattr(Body, "pose", moved)
    assert not check_clouds.compare(task).passed


def test_our_triangles_are_what_is_rendered(task: Any) -> None:
    """Link by link: the same corners and the same area, of object, plinth and arm."""
    from lerobot_env_adamanip.sim.triangles import robot_triangles, shapes_triangles

    ours = {body.entity.name: shapes_triangles(body.shapes) for body in task._objects.visible}
    arm = robot_triangles(Path(task.agent.urdf_path))
    entities = {body.entity.name: body.entity for body in task._objects.visible}
    entities |= {link.entity.name: link.entity for link in task.agent.robot._objs[0].links}
    for name, triangles in {**ours, **arm}.items():
        theirs = _rendered_triangles(entities[name])
        assert len(theirs) >= len(triangles) > 0, name
        for edge in (np.min, np.max):
            np.testing.assert_allclose(edge(triangles, (0, 1)), edge(theirs, (0, 1)), atol=2e-6, err_msg=name)
        np.testing.assert_allclose(_area(triangles), _area(theirs), rtol=1e-4, err_msg=name)


def _area(triangles: np.ndarray) -> float:
    sides = triangles.astype(np.float64)
    return float(np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1).sum() / 2)


def _rendered_triangles(entity: Any) -> np.ndarray:
    """What SAPIEN has of an entity's looks, (N, 3, 3), in its frame: boxes and cylinders come as unit ones."""
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


def test_pictures_on_demand_look_as_those_of_a_rendered_scene(task: Any) -> None:
    task.reset(seed=311)
    other = make_task(task.category)
    try:
        other.reset(seed=311)
        rendered, taken = (each.observe().image.astype(float) for each in (task, other))
    finally:
        other.close()
    assert taken.shape == rendered.shape
    assert np.abs(taken - rendered).mean() < 3.0  # a rendered scene's is larger and made smaller: smoother edges
    assert np.abs(taken.mean((0, 1)) - rendered.mean((0, 1))).max() < 0.5


def test_pictures_are_the_same_without_the_table_of_reflections(monkeypatch: pytest.MonkeyPatch) -> None:
    images = []
    for pack in ("unlit", "as SAPIEN has it"):
        if pack != "unlit":
            assert rendering._unlit_pack() is not None  # this SAPIEN's shaders are written as we expect
            monkeypatch.setattr(rendering, "_unlit_pack", lambda: None)
        env = KeyframeEnv("safe", image_size=128, num_points=64)
        try:
            images.append(env.reset(seed=5)[0]["pixels"]["front"])
        finally:
            env.close()
    assert images[0].std() > 10.0
    np.testing.assert_array_equal(*images)


def test_what_does_not_move_is_seen_as_if_it_were_cast_anew() -> None:
    env = KeyframeEnv("lamp", observe_images=False, num_points=64)
    try:
        env.reset(seed=5)
        views = env._running().views
        first = views.points()
        views.set_joints(views.joints() + np.float32(0.02))
        moved = views.points()
        views._cast = None
        np.testing.assert_array_equal(moved, views.points())
        assert first.shape != moved.shape or not np.array_equal(first, moved)
    finally:
        env.close()


TRY = """
import json, sys
import numpy as np
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
env = KeyframeEnv("safe", num_points=64, image_size=64, observe_images=False)
cloud = env.reset(seed=4)[0]["point_cloud"]
picture = env.render()
env.close()
said = []
for wanted in ({"observe_images": True}, {"observe_images": False, "cloud_source": "render"}):
    env = KeyframeEnv("safe", num_points=64, image_size=64, **wanted)
    try:
        env.reset(seed=4)
    except SimulatorError as error:
        said.append(str(error))
    env.close()
print(json.dumps({"cloud": cloud.tolist(), "colors": len(np.unique(picture)), "said": said}))
"""


def test_without_a_vulkan_device_clouds_are_the_same_and_videos_are_shaded() -> None:
    told = in_fresh_process(TRY, **NO_VULKAN)
    env = KeyframeEnv("safe", num_points=64, image_size=64, observe_images=False)
    try:
        np.testing.assert_array_equal(np.asarray(told["cloud"], np.float32), env.reset(seed=4)[0]["point_cloud"])
    finally:
        env.close()
    assert told["colors"] > 20
    assert len(told["said"]) == 2
    assert all("no Vulkan device" in text and "--no-images" in text for text in told["said"])
