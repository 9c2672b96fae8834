"""A cloud from a depth picture is the simulator's cloud, whichever is searched for the other's points."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lerobot_adamanip.contract.observation import workspace_cloud
from lerobot_adamanip.contract.schema import PAPER_NUM_POINTS
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, simulated_calibration
from lerobot_adamanip.hardware.depth_cloud import depth_cloud, points_in_base
from lerobot_env_adamanip.simulator import make_task

pytestmark = pytest.mark.sim
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
    pixels, points = RaycastSensor(cameras.cloud_config, cameras.bodies(), workspace).pixels()
    depth = np.zeros(size**2, np.uint16)
    depth[pixels] = -points[:, 2]
    depth, dense = depth.reshape(size, size), cameras.points()
    cloud = depth_cloud(depth, calibration, POINTS, workspace)
    own = workspace_cloud(dense, workspace, POINTS)
    pairs = ((dense, cloud), (points_in_base(depth, calibration), own))
    return [1e3 * cKDTree(others).query(points)[0] for others, points in pairs]


def _are_equal(distances: list[Any]) -> bool:
    return all(np.median(each) <= MEDIAN_MM and np.percentile(each, 99) <= P99_MM for each in distances)


def test_clouds_from_depth_are_the_simulators(task: Any) -> None:
    assert _are_equal(_distances(task, _calibration(task)))


def test_a_camera_that_is_two_millimetres_beside_is_noticed(task: Any) -> None:
    known = _calibration(task)
    assert known.depth_in_base is not None
    moved = known.depth_in_base.copy()
    moved[:3, 3] += 2e-3
    assert not _are_equal(_distances(task, replace(known, depth_in_base=moved)))


def test_half_a_pixel_is_counted_as_opencv_does(task: Any) -> None:
    """A wall-to-wall offset that nearest neighbours hardly show: so by the ray of each pixel."""
    size, matrix = task.cameras.cloud_config.width, _calibration(task).depth.matrix
    rays = _camera(task).rays().reshape(size, size, 3)
    for row, column in ((0, 0), (17, 200), (size - 1, size // 2)):
        ray = np.linalg.solve(matrix, [column, row, 1.0])
        assert ray == pytest.approx(rays[row, column] * (1, -1, -1), abs=1e-6)  # OpenCV looks along z, y down
