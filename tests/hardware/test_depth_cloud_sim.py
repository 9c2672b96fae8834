"""A cloud from the simulator's depth is the simulator's cloud. The full run: ``scripts/check_depth_cloud.py``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import check_depth_cloud
import numpy as np
import pytest

from lerobot_adamanip.hardware.camera_frames import simulated_calibration
from lerobot_env_adamanip.simulator import make_task

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def task() -> Any:
    task = make_task("microwave", cloud_source="raycast")
    task.reset(seed=501)
    yield task
    task.close()


def test_clouds_from_depth_are_the_simulators(task: Any) -> None:
    told = check_depth_cloud.summary([check_depth_cloud.compare(task, 1024)])
    assert told["seen"]["median_mm"] <= check_depth_cloud.MEDIAN
    assert told["kept"]["median_mm"] <= check_depth_cloud.MEDIAN
    assert told["seen"]["p99_mm"] <= check_depth_cloud.P99
    assert told["kept"]["p99_mm"] <= check_depth_cloud.P99


def test_a_camera_that_is_two_millimetres_beside_is_noticed(task: Any) -> None:
    known = simulated_calibration(check_depth_cloud.camera_of(task))
    assert known.depth_in_base is not None
    moved = known.depth_in_base.copy()
    moved[:3, 3] += 2e-3
    beside = replace(known, depth_in_base=moved)
    assert not check_depth_cloud.summary([check_depth_cloud.compare(task, 1024, beside)])["passed"]


def test_half_a_pixel_is_counted_as_opencv_does(task: Any) -> None:
    """A wall-to-wall offset that nearest neighbours hardly show: so by the ray of each pixel."""
    camera = check_depth_cloud.camera_of(task)
    from lerobot_env_adamanip.sim.camera import pinhole

    size, known = task.views.depth_size, simulated_calibration(camera)
    rays = pinhole(task.views.camera(size, "front")).rays().reshape(size, size, 3)
    matrix = known.depth.matrix
    for row, column in ((0, 0), (17, 200), (size - 1, size // 2)):
        ray = np.linalg.solve(matrix, [column, row, 1.0])
        assert ray == pytest.approx(rays[row, column] * (1, -1, -1), abs=1e-6)  # OpenCV looks along z, y down
