from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, transform
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics, read_calibrations, save_calibration
from lerobot_adamanip.util.errors import ConfigurationError

POSE = transform((0.1, -0.58, 1.16), matrix_from_rotation_vector(np.array([0.3, -2.0, 0.4])))
DEPTH = Intrinsics(np.array([[380.1, 0, 320.2], [0, 381.3, 239.9], [0, 0, 1]]), np.array([0.1, 0, 0, 0, 0.2]), 640, 480)
FRONT = CameraCalibration("0123456789", DEPTH, POSE, None, DEPTH, np.eye(4))
WRIST = CameraCalibration("wrist one", DEPTH, None, POSE)


def test_what_is_written_is_read_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "new" / "lab.cameras.json"
    save_calibration(path, "front", FRONT, {"rms_px": 0.21, "date": "2026-01-02"})
    save_calibration(path, "wrist", WRIST)
    found = read_calibrations(path)
    assert list(found) == ["front", "wrist"]
    for one, other in ((found["front"], FRONT), (found["wrist"], WRIST)):
        assert one.camera == other.camera
        for name in ("depth_in_base", "depth_in_tcp", "depth_in_color"):
            assert np.array_equal(getattr(one, name), getattr(other, name)) or getattr(other, name) is None
            assert (getattr(one, name) is None) == (getattr(other, name) is None)
        assert np.array_equal(one.depth.matrix, DEPTH.matrix)
        assert np.array_equal(one.depth.distortion, DEPTH.distortion)
        assert (one.depth.width, one.depth.height) == (640, 480)
    assert found["wrist"].color is None
    assert json.loads(path.read_text())["cameras"]["front"]["found"]["rms_px"] == 0.21
    save_calibration(path, "front", WRIST)
    assert read_calibrations(path)["front"].camera == "wrist one"
    assert json.loads(path.read_text())["cameras"]["wrist"]["found"] == {}


TEXT = json.dumps(
    {
        "version": 1,
        "cameras": {
            "front": {
                "camera": "1",
                "depth": {"matrix": DEPTH.matrix.tolist(), "distortion": [], "width": 640, "height": 480},
                "depth_in_base": POSE.tolist(),
                "depth_in_tcp": None,
                "color": None,
                "depth_in_color": None,
                "found": {},
            }
        },
    }
)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"depth_in_base": (2 * np.eye(4)).tolist()}, "no pose"),
        ({"depth_in_base": np.diag([1.0, 1, -1, 1]).tolist()}, "no pose"),
        ({"depth_in_base": np.eye(3).tolist()}, "a list of 4"),
        ({"depth_in_base": None}, "neither"),
        ({"depth_in_tcp": np.eye(4).tolist()}, "in the base's frame and on the tool"),
        ({"surprise": 1}, "unknown field"),
        ({"camera": "a\nb"}, "serial number"),
        ({"found": {"a": [1]}}, "text"),
        ({"depth": {"matrix": np.eye(3).tolist(), "distortion": [0.1], "width": 640, "height": 480}}, "coefficients"),
    ],
)
def test_a_file_that_is_none_is_named_and_left_alone(tmp_path: Path, change: dict[str, Any], named: str) -> None:
    path = tmp_path / "lab.cameras.json"
    told = json.loads(TEXT)
    path.write_text(json.dumps(told))
    assert read_calibrations(path)["front"].camera == "1"
    told["cameras"]["front"].update(change)
    path.write_text(json.dumps(told))
    before = path.read_bytes()
    with pytest.raises(ConfigurationError, match=named) as caught:
        read_calibrations(path)
    assert "lab.cameras.json" in str(caught.value)
    with pytest.raises(ConfigurationError):
        save_calibration(path, "wrist", WRIST)
    assert path.read_bytes() == before


def test_other_versions_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="adamanip calibrate"):
        read_calibrations(tmp_path / "none.json")
    (tmp_path / "two.json").write_text(TEXT.replace('"version": 1', '"version": 2'))
    with pytest.raises(ConfigurationError, match="version is 2"):
        read_calibrations(tmp_path / "two.json")


def test_what_could_not_be_read_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "lab.cameras.json"
    with pytest.raises(ConfigurationError, match="no pose"):
        save_calibration(path, "front", CameraCalibration("1", DEPTH, 2 * np.eye(4)))
    with pytest.raises(ConfigurationError, match="a camera's key"):
        save_calibration(path, "no key", FRONT)
    assert not path.exists()
