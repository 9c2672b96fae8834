"""Intrinsics have one convention, OpenCV's, in collected datasets, converted recordings and the twin's calibration."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import PIXEL_CONVENTION
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics, simulated_calibration
from lerobot_adamanip.hardware.depth_cloud import points_in_base
from lerobot_adamanip.recordings.rows import camera_record, square_image
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.raycast import PinholeCamera, camera_parameters

FIELD_OF_VIEW = np.radians(52)


def pinhole(size: int) -> PinholeCamera:
    return PinholeCamera(np.eye(4), size, 0.5 * size / np.tan(0.5 * FIELD_OF_VIEW))


def pixels(camera: dict[str, Any], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the pixel coordinates (N, 2) of points in the camera's frame, OpenCV axes."""
    ahead = points / points[:, 2:]
    return (ahead @ np.asarray(camera["intrinsics"]).T)[:, :2]


@pytest.mark.parametrize("size", [2, 96, 255, 256])
def test_the_ray_of_a_pixel_projects_to_its_indices(size: int) -> None:
    camera = pinhole(size)
    seen = pixels(camera_parameters(camera), camera.rays() * (1, -1, -1))
    rows, columns = np.mgrid[:size, :size]
    np.testing.assert_allclose(seen, np.stack([columns.ravel(), rows.ravel()], axis=1), atol=1e-9)


@pytest.mark.parametrize("size", [96, 255, 256, 512])
@pytest.mark.parametrize("stored", [64, 255, 256, None])
def test_collected_and_recorded_datasets_of_one_camera_agree(size: int, stored: int | None) -> None:
    recorded = camera_record(simulated_calibration(camera_parameters(pinhole(size))), stored)
    collected = camera_parameters(pinhole(stored or size))
    assert recorded["convention"] == collected["convention"] == PIXEL_CONVENTION
    np.testing.assert_allclose(recorded["intrinsics"], collected["intrinsics"], rtol=1e-12)
    assert recorded["intrinsics"][0][2] == pytest.approx((recorded["width"] - 1) / 2)


def test_the_record_describes_the_cropped_and_resized_picture() -> None:
    """A wide, off-centre camera: a bright block stays where its projection is."""
    matrix = np.array([[500.0, 0.0, 310.0], [0.0, 510.0, 250.0], [0.0, 0.0, 1.0]])
    imager = Intrinsics(matrix, np.zeros(0), 640, 480)
    record = camera_record(CameraCalibration("wide", imager, np.eye(4)), 120)
    picture = np.zeros((480, 640, 3), np.uint8)
    picture[200:204, 300:304] = 255  # one pixel after resizing by 1/4; its middle is at (301.5, 201.5)
    small = square_image(picture, 120)[..., 0]
    middle = np.linalg.solve(matrix, [301.5, 201.5, 1.0])[None]
    (column, row), (brightest,) = pixels(record, middle)[0], np.argwhere(small == small.max())
    assert (row, column) == pytest.approx(tuple(brightest), abs=1e-9)


def test_a_stored_depth_and_stored_intrinsics_give_the_rays_to_the_bit() -> None:
    camera = pinhole(240)
    depth = np.full((240, 240), 700, np.uint16)
    cloud = points_in_base(depth, simulated_calibration(camera_parameters(camera)))
    pose = (camera.pose @ np.diag([1.0, -1.0, -1.0, 1.0]))[:3, :3].astype(np.float32)
    plane = camera.rays()[:, :2] * (1, -1)  # as float32 numbers: a ray of half a pixel beside differs in all of them
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=1).astype(np.float32)
    np.testing.assert_array_equal(cloud, rays * (np.float32(700) * np.float32(1e-3)) @ pose.T)


def test_unnamed_pixel_coordinates_are_refused() -> None:
    camera = camera_parameters(pinhole(8))
    for convention in (None, "corner"):
        with pytest.raises(ConfigurationError, match="unknown pixel coordinates"):
            simulated_calibration({**camera, "convention": convention})
