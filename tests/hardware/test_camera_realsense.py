"""The RealSense camera on a stand-in for its SDK, of which the names were checked against pyrealsense2 2.56."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator
from enum import Enum
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from lerobot.cameras.realsense import camera_realsense as stock
from lerobot.cameras.utils import make_cameras_from_configs

from lerobot_adamanip.hardware.cameras.adamanip_realsense import AdamanipRealsense
from lerobot_adamanip.hardware.cameras.config_adamanip_realsense import AdamanipRealsenseConfig
from lerobot_adamanip.util.errors import RobotError

H, W = 12, 16
Model = Enum("Model", ["none", "brown_conrady", "inverse_brown_conrady", "ftheta"])


def fake_frame(data: Any, number: int, stamp_ms: float) -> Any:
    return SimpleNamespace(
        get_data=lambda: data,
        get_frame_number=lambda: number,
        get_timestamp=lambda: stamp_ms,
    )


class FakeProfile:
    def __init__(self, device: FakeDevice, kind: str) -> None:
        self.device, self.kind = device, kind

    def as_video_stream_profile(self) -> Any:
        return SimpleNamespace(fps=lambda: 30, width=lambda: W, height=lambda: H, get_intrinsics=self.get_intrinsics)

    def get_intrinsics(self) -> Any:
        focal = 100.0 if self.kind == "depth" else 200.0
        lens = {"coeffs": [0.1, 0, 0, 0, 0], "model": self.device.model}
        return SimpleNamespace(fx=focal, fy=focal + 1, ppx=8.0, ppy=6.0, width=W, height=H, **lens)

    def get_extrinsics_to(self, other: FakeProfile) -> Any:
        assert (self.kind, other.kind) == ("depth", "color")
        columns = [0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0]  # a quarter turn about z, by columns
        return SimpleNamespace(rotation=columns, translation=[0.015, 0.0, 0.001])


class FakeDevice:
    """Pipeline, profile and sensor of what is plugged in: frames are put into `pairs`."""

    def __init__(self, scale: float) -> None:
        self.scale, self.model = scale, Model.brown_conrady
        self.pairs: queue.Queue[Any] = queue.Queue()
        self.stopped = self.number = 0

    def push(
        self, counts: Any, *, color: bool = True, depth: bool = True, same: bool = False, age: float = 0.0
    ) -> None:
        self.number += not same
        stamp = 1e3 * (time.time() - age)
        tint = fake_frame(np.full((H, W, 3), self.number % 256, np.uint8), self.number, stamp)
        counted = counts if isinstance(counts, np.ndarray) else np.full((H, W), counts, np.uint16)
        deep = fake_frame(counted, self.number, stamp)
        pair = {"get_color_frame": lambda: tint if color else None, "get_depth_frame": lambda: deep if depth else None}
        self.pairs.put(SimpleNamespace(**pair))

    def start(self, config: Any) -> FakeDevice:
        return self

    get_device = first_depth_sensor = lambda self: self

    def stop(self) -> None:
        self.stopped += 1

    def try_wait_for_frames(self, timeout_ms: int) -> tuple[bool, Any]:
        try:
            found = self.pairs.get(timeout=timeout_ms / 1e3)
        except queue.Empty:
            return False, None
        if isinstance(found, Exception):
            raise found
        return True, found

    def get_stream(self, kind: str) -> FakeProfile:
        return FakeProfile(self, kind)

    def get_depth_scale(self) -> float:
        return self.scale


class FakeConfig:
    def enable_device(self, serial: str) -> None:
        assert serial == "123"

    def enable_stream(self, *options: Any) -> None:
        pass


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> FakeDevice:
    """A D405, which counts depth in 0.1 mm."""
    device = FakeDevice(0.0001)
    sdk = SimpleNamespace(
        pipeline=lambda: device,
        config=FakeConfig,
        stream=SimpleNamespace(color="color", depth="depth"),
        format=SimpleNamespace(rgb8="rgb8", z16="z16"),
        context=lambda: SimpleNamespace(query_devices=list),
    )
    monkeypatch.setattr(stock, "rs", sdk)
    monkeypatch.setattr(stock, "require_package", lambda *args, **kwargs: None)
    return device


@pytest.fixture
def camera(device: FakeDevice) -> Iterator[AdamanipRealsense]:
    made = make_cameras_from_configs({"front": AdamanipRealsenseConfig(serial_number_or_name="123")})["front"]
    assert isinstance(made, AdamanipRealsense)
    made.connect(warmup=False)
    yield made
    if made.is_connected:
        made.disconnect()


@pytest.mark.parametrize(("scale", "millimetres"), [(0.0001, 457), (0.001, 4567), (0.1, 0)])
def test_depth_is_in_millimetres_whatever_the_camera_counts_in(
    camera: AdamanipRealsense, device: FakeDevice, scale: float, millimetres: int
) -> None:
    """What cannot be told in millimetres of 16 bits is not seen. Frames are copies: the SDK reuses its own."""
    camera.disconnect()
    device.scale = scale
    camera.connect(warmup=False)
    shared = np.full((H, W), 4567, np.uint16)
    device.push(shared)
    depth = camera.frame_after(0.0, 5.0).depth
    shared[:] = 0
    assert depth is not None
    assert depth.dtype == np.uint16
    assert (depth == millimetres).all()
    assert camera.read_latest_depth(max_age_ms=60_000).shape == (H, W, 1)


def test_the_stamp_is_the_exposure_not_the_arrival(camera: AdamanipRealsense, device: FakeDevice) -> None:
    before = time.perf_counter()
    device.push(1000, age=0.2)
    frame = camera.frame_after(0.0, 5.0)
    assert frame.arrival >= before
    assert before - 0.2 - 0.02 <= frame.stamp <= before - 0.2 + 0.02


def test_a_picture_stamped_with_another_clock_may_be_as_old_as_the_pipeline(
    camera: AdamanipRealsense, device: FakeDevice, caplog: pytest.LogCaptureFixture
) -> None:
    rest = time.perf_counter()
    for age in (3600.0, -3600.0, time.time() - 50.0):  # a clock that was set, one that counts from switching on
        device.push(1000, age=age)
        frame = camera.frames.next(5.0)
        assert frame is not None
        assert frame.stamp == pytest.approx(frame.arrival - 0.1 - 4 / 30)
    while time.perf_counter() < rest + 0.1 + 4 / 30:
        time.sleep(0.01)
    device.push(1000, age=3600.0)
    assert camera.frame_after(rest, 5.0).number == 4
    assert sum("not on this computer's clock" in message for message in caplog.messages) == 1


def test_half_a_pair_and_a_repeated_exposure_are_dropped(camera: AdamanipRealsense, device: FakeDevice) -> None:
    device.push(1000)
    first = camera.frame_after(0.0, 5.0)
    device.push(2000, depth=False)
    device.push(3000, color=False)
    device.push(4000, same=True)  # still number 3, the one that lost its colour
    device.push(9990)
    frame = camera.frame_after(first.stamp, 5.0)
    while frame.depth is not None and frame.depth[0, 0] != 999:
        frame = camera.frame_after(frame.stamp, 5.0)
    assert frame.color is not None
    assert frame.color[0, 0, 0] == frame.number == 4
    device.push(5000, same=True)
    with pytest.raises(RobotError, match="Camera 123: It is frozen"):
        camera.frame_after(frame.stamp, 0.5)


def test_a_camera_that_is_pulled_out_is_named(camera: AdamanipRealsense, device: FakeDevice) -> None:
    device.push(1000)
    frame = camera.frame_after(0.0, 5.0)
    device.pairs.put(RuntimeError("Device disconnected"))
    with pytest.raises(RobotError, match=r"Camera 123: It has failed[\s\S]*Device disconnected"):
        camera.frame_after(frame.stamp, 10.0)
    camera.disconnect()
    assert device.stopped == 1
    assert not camera.is_connected


def test_intrinsics_and_extrinsics_are_opencvs(camera: AdamanipRealsense, device: FakeDevice) -> None:
    depth, color = camera.depth_intrinsics(), camera.color_intrinsics()
    assert (depth.matrix[0, 0], depth.matrix[1, 1], color.matrix[0, 0]) == (100, 101, 200)
    assert (depth.matrix[0, 2], depth.matrix[1, 2], depth.width, depth.height) == (8, 6, W, H)
    assert depth.distortion[0] == pytest.approx(0.1)
    pose = camera.depth_in_color()
    assert pose is not None
    assert pose @ [1.0, 0.0, 0.0, 1.0] == pytest.approx([0.015, 1.0, 0.001, 1.0])
    device.model = Model.ftheta
    with pytest.raises(RobotError, match="no pinhole"):
        camera.depth_intrinsics()
    camera.disconnect()
    with pytest.raises(RobotError, match="not connected"):
        camera.depth_intrinsics()


def test_connecting_tries_again_and_says_which_camera_gave_nothing(
    device: FakeDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    resets: list[int] = []
    monkeypatch.setattr(AdamanipRealsense, "_hardware_reset", lambda self: resets.append(1))
    monkeypatch.setattr(AdamanipRealsense, "frame_after", _nothing)
    camera = AdamanipRealsense(AdamanipRealsenseConfig(serial_number_or_name="123"))
    with pytest.raises(RobotError, match="Camera 123: It cannot be opened"):
        camera.connect()
    assert (device.stopped, len(resets)) == (3, 1)
    assert not camera.is_connected


def _nothing(self: AdamanipRealsense, stamp: float, timeout: float) -> None:
    raise self._error("It is frozen.", "no new frame", "frames")
