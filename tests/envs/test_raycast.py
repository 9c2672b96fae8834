"""Rays end where geometry says, whatever the order of links, and only those are cast that can end in the workspace."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.objects import Material, Shape
from lerobot_env_adamanip.sim import render_device
from lerobot_env_adamanip.sim.raycast import LinkMesh, PinholeCamera, RayScene
from lerobot_env_adamanip.sim.render_device import resolve_cloud_source
from lerobot_env_adamanip.sim.triangles import box_triangles, shape_triangles

SIZE = 48
WORKSPACE = Workspace((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
# Looks along the world's -z from two metres above.
CAMERA = PinholeCamera(transform((0.0, 0.0, 2.0)), SIZE, 40.0)
GREY = Material((0.5, 0.5, 0.5))


def depth_image(scene: RayScene, *links: tuple[LinkMesh, Any]) -> np.ndarray:
    depth = scene.empty()
    scene.cast(links, depth)
    image = np.full(SIZE * SIZE, np.inf)
    met = scene.met(depth)
    image[scene.pixels[met]] = depth[met]
    return image.reshape(SIZE, SIZE)


def test_a_boxs_face_is_seen_where_it_is() -> None:
    image = depth_image(RayScene(CAMERA, WORKSPACE), (LinkMesh(box_triangles((0.3, 0.2, 0.1))), np.eye(4)))
    rays = CAMERA.rays().reshape(SIZE, SIZE, 3)
    on_top = (np.abs(rays[..., 0] * 1.9) <= 0.3) & (np.abs(rays[..., 1] * 1.9) <= 0.2)
    assert on_top.sum() > 50
    np.testing.assert_array_equal(np.isfinite(image), on_top)  # from straight above no side is seen
    np.testing.assert_allclose(image[on_top], 1.9, atol=1e-6)


def test_a_wall_that_is_turned_has_the_depth_of_its_plane() -> None:
    pose = transform((0.1, -0.2, 0.3), rotation_about((1.0, 2.0, 0.5), 0.7))
    image = depth_image(RayScene(CAMERA, WORKSPACE), (LinkMesh(box_triangles((5.0, 5.0, 1e-6))), pose))
    rays = CAMERA.rays().reshape(SIZE, SIZE, 3)
    normal, point = pose[:3, 2], pose[:3, 3] - (0.0, 0.0, 2.0)
    wanted = (normal @ point) / (rays @ normal)
    seen = np.isfinite(image)
    assert seen.sum() > 200
    np.testing.assert_allclose(image[seen], wanted[seen], atol=1e-5)


def test_neither_the_order_of_links_nor_what_was_cast_before_matters() -> None:
    mesh = LinkMesh(box_triangles((0.2, 0.2, 0.05)))
    links = [(mesh, transform((0.1 * k, 0.05 * k, 0.3 * k), rotation_about((0, 1, 0), 0.4 * k))) for k in range(3)]
    scene = RayScene(CAMERA, WORKSPACE)
    wanted = depth_image(scene, *links)
    for order in itertools.permutations(links):
        np.testing.assert_array_equal(depth_image(scene, *order), wanted)
    depth = scene.empty()
    for one in links[:2]:
        slots, depths = scene.hits(*one)
        depth[slots] = np.minimum(depth[slots], depths)
    scene.cast(links[2:], depth)
    met = scene.met(depth)
    np.testing.assert_array_equal(wanted.ravel()[scene.pixels[met]], depth[met])
    assert len(met) == np.isfinite(wanted).sum()


def test_what_lies_outside_the_workspace_hides_but_is_no_end() -> None:
    low = Workspace((-1.0, -1.0, -1.0), (1.0, 1.0, 0.0))
    lid = LinkMesh(box_triangles((0.1, 0.1, 0.01)))
    floor = (LinkMesh(box_triangles((3.0, 3.0, 0.01))), transform((0.0, 0.0, -0.5)))
    below = (LinkMesh(box_triangles((3.0, 3.0, 0.01))), transform((0.0, 0.0, -2.0)))
    scene = RayScene(CAMERA, low)
    np.testing.assert_array_equal(depth_image(scene, floor, below), depth_image(scene, floor))
    hidden = depth_image(scene, floor, (lid, transform((0.0, 0.0, 1.0))))
    assert (hidden < 1.1).any()


def test_no_ray_is_cast_that_cannot_end_in_the_workspace() -> None:
    small = Workspace((0.2, 0.2, -0.1), (0.4, 0.4, 0.1))
    scene = RayScene(CAMERA, small)
    assert 0 < len(scene.pixels) < 0.1 * SIZE * SIZE
    assert len(RayScene(CAMERA, Workspace((5.0, 5.0, 2.5), (6.0, 6.0, 3.0))).pixels) == 0


def test_a_link_around_the_camera_is_seen_from_inside() -> None:
    room = LinkMesh(box_triangles((0.9, 0.9, 2.5)))
    assert np.isfinite(depth_image(RayScene(CAMERA, WORKSPACE), (room, np.eye(4)))).any()


@pytest.mark.parametrize(
    ("shape", "triangles", "extent"),
    [
        (Shape("box", (0.1, 0.2, 0.3), np.eye(4), GREY), 12, (0.1, 0.2, 0.3)),
        (Shape("cylinder", (0.1, 0.3), np.eye(4), GREY), 128, (0.3, 0.1, 0.1)),
        (Shape("capsule", (0.1, 0.3), np.eye(4), GREY), 1024, (0.4, 0.1, 0.1)),
    ],
    ids=lambda value: value.kind if isinstance(value, Shape) else "",
)
def test_shapes_have_as_many_facets_as_the_renderers(
    shape: Shape, triangles: int, extent: tuple[float, float, float]
) -> None:
    made = shape_triangles(shape)
    assert len(made) == triangles
    np.testing.assert_allclose(made.reshape(-1, 3).max(0), extent, rtol=1e-6)
    np.testing.assert_allclose(made.reshape(-1, 3).min(0), [-each for each in extent], rtol=1e-6)


def test_without_embreex_clouds_are_rendered_and_one_line_says_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert resolve_cloud_source("raycast") == "raycast"
    monkeypatch.setattr(render_device.importlib.util, "find_spec", lambda name: None)
    render_device._warn_once.cache_clear()
    assert [resolve_cloud_source("raycast") for _ in range(3)] == ["render"] * 3
    assert [record.message for record in caplog.records if "embreex" in record.message] == [caplog.messages[0]]


def test_another_source_is_refused() -> None:
    with pytest.raises(ValueError, match=r"(?s)source of clouds.*raycast, render"):
        EnvironmentOptions(cloud_source="guess")
