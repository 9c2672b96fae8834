"""The Azure Kinect on a stand-in for its C library; numbers of the calibration are those of libk4a 1.4.2 itself."""

from __future__ import annotations

import ctypes
import queue
import time
from typing import Any

import numpy as np
import pytest
from lerobot.cameras.utils import make_cameras_from_configs

from lerobot_adamanip.hardware.calibration.projection import project
from lerobot_adamanip.hardware.cameras import k4a_native as native
from lerobot_adamanip.hardware.cameras.adamanip_k4a import AdamanipK4a
from lerobot_adamanip.hardware.cameras.config_adamanip_k4a import AdamanipK4aConfig
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

H, W = 6, 8
DEPTH_LENS = (
    332.78106689, 348.82971191, 504.6076355, 504.73251343, 0.547939777, -0.0209713709, -0.0026522316, 0.889679074,
    0.0861302093, -0.0139103848, 0, 0, -7.21041579e-05, 2.05575343e-05, 0,
)  # fmt: skip
COLOR_LENS = (
    639.30432129, 365.85290527, 611.79534912, 611.92700195, 0.330121309, -2.48939657, 1.45367086, 0.208912075,
    -2.3029151, 1.37512755, 0, 0, -1.29445252e-04, -1.61782446e-04, 0,
)  # fmt: skip
TURN = (
    0.999999225, 1.18175766e-03, -4.48140432e-04, -1.13875128e-03, 0.996280611, 0.0861603245, 5.48294222e-04,
    -0.0861597508, 0.996281207,
)  # fmt: skip
SHIFT = (-32.0834294, -2.20537302, 3.88369267)  # mm
SEEN = {  # point before the depth imager [mm] -> pixels of the depth and of the colour imager, as libk4a tells them
    (100.0, -50.0, 800.0): ((395.438690, 317.493011), (690.629517, 378.625732)),
    (-200.0, 150.0, 900.0): ((223.470825, 430.831390), (477.054260, 523.014587)),
}


class FakeLibrary:
    """Devices by serial number, and a queue of captures: (depth, colour, microseconds), or a result code."""

    def __init__(self, *serials: str) -> None:
        self.serials = serials
        self.captures: queue.Queue[Any] = queue.Queue()
        self.images: dict[int, tuple[Any, int]] = {}
        self.given = 0
        self.calls: list[str] = []
        self.asked: Any = None

    def __getattr__(self, name: str) -> Any:
        if name in ("k4a_device_close", "k4a_device_stop_cameras", "k4a_capture_release"):
            return lambda handle: self.calls.append(f"{name[4:]} {handle.value}")
        raise AttributeError(name)

    def k4a_device_get_installed_count(self) -> int:
        return len(self.serials)

    def k4a_device_open(self, index: int, device: Any) -> int:
        device._obj.value = index + 1
        return int(self.serials[index] == "in use")

    def k4a_device_get_serialnum(self, device: Any, text: Any, size: Any) -> int:
        text.value = self.serials[device.value - 1].encode()
        return 0

    def k4a_device_get_calibration(self, device: Any, depth_mode: int, color_resolution: int, told: Any) -> int:
        known = told._obj
        for imager, lens, size in ((known.depth, DEPTH_LENS, (W, H)), (known.color, COLOR_LENS, (1280, 720))):
            imager.parameters = native.Parameters(*lens)
            imager.resolution_width, imager.resolution_height = size
        known.extrinsics[native.DEPTH][native.COLOR] = native.Extrinsics(TURN, SHIFT)
        return 0

    def k4a_device_start_cameras(self, device: Any, asked: Any) -> int:
        self.asked = asked._obj
        return int(asked._obj.depth_mode == 4 and asked._obj.camera_fps == 2)  # which the device does not have

    def k4a_device_get_capture(self, device: Any, capture: Any, timeout: int) -> int:
        try:
            found = self.captures.get(timeout=timeout / 1e3)
        except queue.Empty:
            return native.TIMED_OUT
        if isinstance(found, int):
            return found
        self.given += 10
        depth, color, stamp = found
        for offset, image in ((0, depth), (1, color)):
            if image is not None:
                padded = np.zeros((H, (W + 3) * image[0, 0].nbytes), np.uint8)  # rows longer than the picture
                padded[:, : W * image[0, 0].nbytes] = image.view(np.uint8).reshape(H, -1)
                self.images[self.given + offset] = (padded, stamp)
        capture._obj.value = self.given
        return 0

    def k4a_capture_get_depth_image(self, capture: Any) -> int | None:
        return capture.value if capture.value in self.images else None

    def k4a_capture_get_color_image(self, capture: Any) -> int | None:
        return capture.value + 1 if capture.value + 1 in self.images else None

    def k4a_image_get_height_pixels(self, image: int) -> int:
        return H

    def k4a_image_get_width_pixels(self, image: int) -> int:
        return W

    def k4a_image_get_stride_bytes(self, image: int) -> int:
        return int(self.images[image][0].shape[1])

    def k4a_image_get_buffer(self, image: int) -> int:
        return int(self.images[image][0].ctypes.data)

    def k4a_image_get_device_timestamp_usec(self, image: int) -> int:
        return self.images[image][1]

    def k4a_image_release(self, image: int) -> None:
        self.calls.append(f"image_release {image}")

    def push(self, millimetres: int, microseconds: int, *, depth: bool = True, color: bool = True) -> None:
        bgra = np.full((H, W, 4), (10, 20, 30, 255), np.uint8)
        self.captures.put(
            (np.full((H, W), millimetres, np.uint16) if depth else None, bgra if color else None, microseconds)
        )


def connected(monkeypatch: pytest.MonkeyPatch, library: FakeLibrary, **options: Any) -> AdamanipK4a:
    monkeypatch.setattr(native, "library", lambda: library)
    camera = make_cameras_from_configs({"front": AdamanipK4aConfig(**options)})["front"]
    assert isinstance(camera, AdamanipK4a)
    camera.connect(warmup=False)
    return camera


def test_frames_are_rgb_and_millimetres_without_the_padding_of_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    library = FakeLibrary("000")
    camera = connected(monkeypatch, library)
    library.push(1234, 1_000_000)
    frame = camera.frame_after(float("-inf"), 10.0)
    assert frame.depth is not None
    assert frame.color is not None
    assert (frame.depth.shape, frame.depth.dtype) == ((H, W), np.uint16)
    assert (frame.depth == 1234).all()
    assert (frame.color == (30, 20, 10)).all()
    assert frame.color.flags.c_contiguous
    assert (camera.width, camera.height, camera.fps, camera.name) == (W, H, 30, "000")
    assert library.asked.synchronized_images_only
    camera.disconnect()
    released = [call for call in library.calls if "release" in call]
    assert sorted(released) == ["capture_release 10", "image_release 10", "image_release 11"]
    assert library.calls[-2:] == ["device_stop_cameras 1", "device_close 1"]


def test_half_a_capture_is_dropped_and_released_and_a_frozen_one_named(monkeypatch: pytest.MonkeyPatch) -> None:
    library = FakeLibrary("000")
    camera = connected(monkeypatch, library)
    library.push(1, 1_000_000, color=False)
    library.push(2, 1_033_000, depth=False)
    library.push(3, 1_066_000)
    frame = camera.frame_after(float("-inf"), 10.0)
    assert frame.depth is not None
    assert (int(frame.depth[0, 0]), frame.number, camera.dropped) == (3, 1, 2)
    with pytest.raises(RobotError, match="Camera 000: It is frozen"):
        camera.frame_after(frame.stamp, 0.5)
    assert len([call for call in library.calls if call.startswith("image_release")]) == 4
    library.captures.put(1)  # failed: the cable was pulled
    with pytest.raises(RobotError, match=r"Camera 000: It has failed[\s\S]*unplugged"):
        camera.frame_after(frame.stamp, 10.0)
    camera.disconnect()


def test_stamps_follow_the_devices_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    library = FakeLibrary("000")
    camera = connected(monkeypatch, library)
    library.push(1, 5_000_000)
    first = camera.frame_after(float("-inf"), 10.0)
    time.sleep(0.3)
    library.push(2, 5_033_000)  # exposed 33 ms after the first, and arrived late
    second = camera.frame_after(first.stamp, 10.0)
    assert second.stamp - first.stamp == pytest.approx(0.033, abs=1e-6)
    assert second.arrival - second.stamp > 0.2
    camera.disconnect()


def test_calibration_is_read_as_the_library_means_it(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = connected(monkeypatch, FakeLibrary("000"))
    pose = camera.depth_in_color()
    assert pose is not None
    for millimetres, (in_depth, in_color) in SEEN.items():
        point = np.array(millimetres) / 1e3
        assert project(point[None], camera.depth_intrinsics())[0] == pytest.approx(in_depth, abs=1e-3)
        assert project((pose @ [*point, 1])[None, :3], camera.color_intrinsics())[0] == pytest.approx(
            in_color, abs=1e-3
        )
    assert ctypes.sizeof(native.Calibration) == 1032
    camera.disconnect()
    with pytest.raises(RobotError, match="not connected"):
        camera.depth_intrinsics()


def test_the_one_that_was_asked_for_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    library = FakeLibrary("in use", "111", "222")
    camera = connected(monkeypatch, library, serial_number="222")
    assert library.calls == ["device_close 2"]
    camera.disconnect()
    with pytest.raises(RobotError, match="Camera 333: It is not there"):
        connected(monkeypatch, FakeLibrary("in use", "111"), serial_number="333")
    library = FakeLibrary("000")
    with pytest.raises(RobotError, match="does not start"):
        connected(monkeypatch, library, depth_mode="wfov_unbinned")
    assert library.calls == ["device_stop_cameras 1", "device_close 1"]
    camera = connected(monkeypatch, FakeLibrary("000"), depth_mode="wfov_unbinned", fps=15, use_rgb=False)
    assert camera.fps == 15
    camera.disconnect()


@pytest.mark.parametrize("options", [{"depth_mode": "off"}, {"color_resolution": "4k"}, {"fps": 60}])
def test_what_it_does_not_have_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="Unknown"):
        AdamanipK4a(AdamanipK4aConfig(**options))


def test_a_missing_wheel_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "WHEEL", "no-such-wheel-of-anybody")
    with pytest.raises(RobotError, match=r"lerobot_env_adamanip\[k4a\]"):
        native.library.__wrapped__()
