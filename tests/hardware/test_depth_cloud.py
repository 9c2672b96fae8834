"""Clouds from depth: geometry, edges, and agreement with the simulator's own cloud."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lerobot_adamanip.contract.observation import RepeatedPointsWarning, workspace_cloud
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, transform
from lerobot_adamanip.contract.schema import PAPER_NUM_POINTS
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics, simulated_calibration
from lerobot_adamanip.hardware.depth_cloud import JUMP, NOTHING_SEEN, depth_cloud, points_in_base
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.simulator import make_task

WIDTH, HEIGHT, FOCAL = 80, 60, 70.0
EVERYWHERE = Workspace((-9, -9, -9), (9, 9, 9))


def calibration(
    pose: NDArray[np.float64] | None = None, lens: tuple[float, ...] = (), **on_the_hand: NDArray[np.float64]
) -> CameraCalibration:
    matrix = np.array([[FOCAL, 0, 39.5], [0, FOCAL + 2, 29.5], [0, 0, 1]])
    intrinsics = Intrinsics(matrix, np.array(lens), WIDTH, HEIGHT)
    in_base = None if on_the_hand else np.eye(4) if pose is None else pose
    return CameraCalibration("test", intrinsics, in_base, **on_the_hand)


def poses() -> st.SearchStrategy[NDArray[np.float64]]:
    numbers = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6)
    return numbers.map(lambda n: transform(n[:3], matrix_from_rotation_vector(np.array(n[3:]))))


def plane_depth(known: CameraCalibration, normal: NDArray[np.float64], away: float) -> NDArray[np.float32]:
    """Depth [mm] of the plane ``normal . p = away`` in the camera's frame, by its equation."""
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    matrix = known.depth.matrix
    x, y = (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]
    return np.asarray(1e3 * away / (normal[0] * x + normal[1] * y + normal[2]), np.float32)


@settings(max_examples=25, deadline=None)
@given(poses(), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.4, 0.9))
def test_points_of_a_plane_lie_on_it_wherever_the_camera_is(
    pose: NDArray[np.float64], tilt_x: float, tilt_y: float, away: float
) -> None:
    known = calibration(pose)
    normal = np.array([tilt_x, tilt_y, 1.0]) / np.linalg.norm([tilt_x, tilt_y, 1.0])
    points = points_in_base(plane_depth(known, normal, away), known)
    assert len(points) == WIDTH * HEIGHT
    normal_in_base, origin = pose[:3, :3] @ normal, pose[:3, 3]
    assert np.abs((points - origin) @ normal_in_base - away).max() < 1e-5


def test_a_pixel_is_its_ray_and_scan_order_is_kept() -> None:
    depth = np.full((HEIGHT, WIDTH), 1000, np.uint16)
    points = points_in_base(depth, calibration()).reshape(HEIGHT, WIDTH, 3)
    assert points[10, 20] == pytest.approx([(20 - 39.5) / 70, (10 - 29.5) / 72, 1.0], abs=1e-6)
    assert (np.diff(points[..., 0], axis=1) > 0).all()
    assert (np.diff(points[..., 1], axis=0) > 0).all()


def test_a_lens_is_undone() -> None:
    """OpenCV projects points through the lens; back-projection has to find them again."""
    import cv2

    lens = (-0.2, 0.05, 0.001, -0.002, 0.01)
    known = calibration(lens=lens)
    points = points_in_base(np.full((HEIGHT, WIDTH), 800, np.uint16), known)
    pixels, _ = cv2.projectPoints(
        points.astype(np.float64), np.zeros(3), np.zeros(3), known.depth.matrix, np.array(lens)
    )
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    assert np.abs(pixels[:, 0] - np.stack([columns.ravel(), rows.ravel()], 1)).max() < 1e-2
    assert np.abs(points - points_in_base(np.full((HEIGHT, WIDTH), 800, np.uint16), calibration())).max() > 0.01


def test_nothing_seen_is_no_point() -> None:
    depth = np.full((HEIGHT, WIDTH), 900, np.float32)
    depth[:30] = NOTHING_SEEN  # what LeRobot's depth video makes of 0 lies below it
    depth[30, :40] = np.nan
    assert len(points_in_base(depth, calibration())) == 29 * WIDTH + 40


def test_flying_pixels_go_and_edges_and_thin_things_stay() -> None:
    depth = np.full((HEIGHT, WIDTH), 1000, np.float32)
    depth[:, 20:] = 700  # an edge: near surface on the right
    assert len(points_in_base(depth, calibration())) == HEIGHT * WIDTH
    depth[:, 19] = 850  # mixed pixels of it
    points = points_in_base(depth, calibration())
    assert len(points) == HEIGHT * (WIDTH - 1)
    assert not np.isclose(points[:, 2], 0.85).any()
    thin = np.full((HEIGHT, WIDTH), 1000, np.float32)
    thin[:, 40] = 950  # a bar, one pixel wide
    thin[30, :] = 940
    points = points_in_base(thin, calibration())
    assert np.isclose(points[:, 2], 0.95).sum() == HEIGHT - 1
    assert np.isclose(points[:, 2], 0.94).sum() == WIDTH
    fleck = np.full((HEIGHT, WIDTH), 1000, np.float32)
    fleck[30, 40] = 1000 - JUMP - 1
    assert len(points_in_base(fleck, calibration())) == HEIGHT * WIDTH - 1
    fleck[30, 40] = 1000 - JUMP + 1
    assert len(points_in_base(fleck, calibration())) == HEIGHT * WIDTH


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_thinned_points_are_points_of_the_whole(stride: int) -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(700, 715, (HEIGHT, WIDTH)).astype(np.float32)
    whole = points_in_base(depth, calibration()).reshape(HEIGHT, WIDTH, 3)
    first = (stride - 1) // 2
    thinned = points_in_base(depth, calibration(), stride)
    assert np.array_equal(thinned, whole[first::stride, first::stride].reshape(-1, 3))


def test_the_cloud_is_cropped_sampled_and_the_same_every_time() -> None:
    depth = np.full((HEIGHT, WIDTH), 800, np.uint16)
    workspace = Workspace((-0.1, -0.1, 0), (0.1, 0.1, 1))
    cloud = depth_cloud(depth, calibration(), 64, workspace)
    assert cloud.shape == (64, 3)
    assert cloud.dtype == np.float32
    assert workspace.contains(cloud).all()
    assert np.array_equal(cloud, depth_cloud(depth.astype(np.float32), calibration(), 64, workspace))
    assert len({tuple(point) for point in cloud}) == 64
    with pytest.warns(RepeatedPointsWarning):
        assert not depth_cloud(np.zeros_like(depth), calibration(), 64, workspace).any()


def test_a_camera_on_the_hand_moves_with_the_tool() -> None:
    rng = np.random.default_rng(1)
    depth_in_tcp = transform((0.05, 0, -0.08), matrix_from_rotation_vector(np.array([0.1, 0.2, 1.5])))
    tcp_in_base = transform(rng.normal(size=3), matrix_from_rotation_vector(rng.normal(size=3)))
    depth = rng.uniform(500, 510, (HEIGHT, WIDTH)).astype(np.float32)
    on_hand = points_in_base(depth, calibration(depth_in_tcp=depth_in_tcp), tcp_in_base=tcp_in_base)
    assert on_hand == pytest.approx(points_in_base(depth, calibration(tcp_in_base @ depth_in_tcp)), abs=1e-6)
    with pytest.raises(ConfigurationError, match="is unknown"):
        points_in_base(depth, calibration(depth_in_tcp=depth_in_tcp))


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="40 x 30"):
        depth_cloud(np.zeros((30, 40), np.uint16), calibration(), 64, EVERYWHERE)


POINTS, MEDIAN_MM, P99_MM = 1024, 1.0, 5.0


@pytest.fixture(scope="module")
def task() -> Any:
    task = make_task("microwave", num_points=PAPER_NUM_POINTS)
    task.reset(seed=501)
    yield task
    task.close()


def _camera(task: Any) -> Any:
    from lerobot_env_adamanip.sim.raycast import pinhole

    return pinhole(task.cameras.cloud_config)


def _calibration(task: Any) -> CameraCalibration:
    from lerobot_env_adamanip.sim.raycast import camera_parameters

    return simulated_calibration(camera_parameters(_camera(task)))


def _distances(task: Any, calibration: CameraCalibration) -> list[Any]:
    """Returns the distances [mm] from the cloud of depth to the simulator's, and from that to the depth's points."""
    from lerobot_env_adamanip.sim.raycast import RaycastSensor

    cameras, workspace, size = task.cameras, task.options.workspace, task.cameras.cloud_config.width
    pixels, points = RaycastSensor(cameras.cloud_config, cameras.bodies, workspace).pixels()
    depth = np.zeros(size**2, np.uint16)
    depth[pixels] = -points[:, 2]
    depth, dense = depth.reshape(size, size), cameras.points()
    cloud = depth_cloud(depth, calibration, POINTS, workspace)
    own = workspace_cloud(dense, workspace, POINTS)
    pairs = ((dense, cloud), (points_in_base(depth, calibration), own))
    return [1e3 * cKDTree(others).query(points)[0] for others, points in pairs]


def _are_equal(distances: list[Any]) -> bool:
    return all(np.median(each) <= MEDIAN_MM and np.percentile(each, 99) <= P99_MM for each in distances)


@pytest.mark.sim
def test_clouds_from_depth_are_the_simulators(task: Any) -> None:
    assert _are_equal(_distances(task, _calibration(task)))


@pytest.mark.sim
def test_a_camera_that_is_two_millimetres_beside_is_noticed(task: Any) -> None:
    known = _calibration(task)
    assert known.depth_in_base is not None
    moved = known.depth_in_base.copy()
    moved[:3, 3] += 2e-3
    assert not _are_equal(_distances(task, replace(known, depth_in_base=moved)))


@pytest.mark.sim
def test_half_a_pixel_is_counted_as_opencv_does(task: Any) -> None:
    """A wall-to-wall offset that nearest neighbours hardly show: so by the ray of each pixel."""
    size, matrix = task.cameras.cloud_config.width, _calibration(task).depth.matrix
    rays = _camera(task).rays().reshape(size, size, 3)
    for row, column in ((0, 0), (17, 200), (size - 1, size // 2)):
        ray = np.linalg.solve(matrix, [column, row, 1.0])
        assert ray == pytest.approx(rays[row, column] * (1, -1, -1), abs=1e-6)  # OpenCV looks along z, y down
