"""The Azure Kinect, through its C library."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from ctypes import byref, c_void_p
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.camera_frames import Frame, Intrinsics
from lerobot_adamanip.hardware.cameras import k4a_native as native
from lerobot_adamanip.hardware.cameras.base import ThreadedCamera
from lerobot_adamanip.hardware.cameras.config_adamanip_k4a import (
    COLOR_RESOLUTIONS,
    DEPTH_MODES,
    RATES,
    AdamanipK4aConfig,
)
from lerobot_adamanip.hardware.cameras.latest import DeviceClock
from lerobot_adamanip.util.errors import RobotError, require_choice

WAIT_MS = 200


class AdamanipK4a(ThreadedCamera):
    """An Azure Kinect.

    Args:
        config: says which.
    """

    config: AdamanipK4aConfig

    def __init__(self, config: AdamanipK4aConfig) -> None:
        super().__init__(config, config.serial_number or "azure kinect", use_rgb=config.use_rgb)
        self._modes = (
            DEPTH_MODES[require_choice("depth mode", config.depth_mode, DEPTH_MODES)],
            COLOR_RESOLUTIONS[require_choice("colour resolution", config.color_resolution, COLOR_RESOLUTIONS)],
        )
        self._rate = int(require_choice("rate", str(config.fps or 30), map(str, RATES)))
        self._sdk: Any = None
        self._device: c_void_p | None = None
        self._calibration = native.Calibration()
        self._clock, self._number, self.dropped = DeviceClock(), 0, 0

    def depth_intrinsics(self) -> Intrinsics:
        """Returns those the camera was calibrated with in the factory; raises `RobotError` while not connected."""
        return self._intrinsics(self._told().depth)

    def color_intrinsics(self) -> Intrinsics:
        """Likewise of the colour imager."""
        return self._intrinsics(self._told().color)

    def depth_in_color(self) -> NDArray[np.float64] | None:
        """Returns the (4, 4) pose [m] of the depth imager in the colour imager's frame."""
        told = self._told().extrinsics[native.DEPTH][native.COLOR]
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(told.rotation, (3, 3))
        pose[:3, 3] = np.array(told.translation) / 1e3
        return pose

    def _told(self) -> native.Calibration:
        if self._device is None:
            raise self._error("It is not connected.", "connect() not called", "connect() first")
        return self._calibration

    def _intrinsics(self, told: Any) -> Intrinsics:
        each = told.parameters
        matrix = np.array([[each.fx, 0.0, each.cx], [0.0, each.fy, each.cy], [0.0, 0.0, 1.0]])
        lens = np.array([each.k1, each.k2, each.p1, each.p2, each.k3, each.k4, each.k5, each.k6])
        return Intrinsics(matrix, lens, told.resolution_width, told.resolution_height)

    def _open(self) -> None:
        self._sdk = native.library()
        for device in self._devices():
            serial = native.serial_number(self._sdk, device)
            if self._device is None and self.config.serial_number in ("", serial):
                self._device, self.name = device, serial or self.name
            else:
                self._sdk.k4a_device_close(device)
        if self._device is None:
            raise self._error("It is not there, or in use.", "no device that can be opened", "one that is plugged in")
        try:
            self._start(self._device)
        except RobotError:
            self._close()
            raise

    def _devices(self) -> Iterator[c_void_p]:
        """Opens one after the other; who takes one closes it."""
        for index in range(self._sdk.k4a_device_get_installed_count()):
            device = c_void_p()
            if self._sdk.k4a_device_open(index, byref(device)) == native.SUCCEEDED:
                yield device

    def _start(self, device: c_void_p) -> None:
        depth_mode, color_resolution = self._modes
        asked = native.Configuration(
            color_format=native.BGRA32,
            color_resolution=color_resolution if self.use_rgb else 0,
            depth_mode=depth_mode,
            camera_fps=RATES[self._rate],
            synchronized_images_only=self.use_rgb,
        )
        told = self._sdk.k4a_device_get_calibration(device, depth_mode, color_resolution, byref(self._calibration))
        if told != native.SUCCEEDED or self._sdk.k4a_device_start_cameras(device, byref(asked)) != native.SUCCEEDED:
            raise self._error("It does not start.", f"{self.config}", "a mode that it has at this rate, on USB 3")
        self.fps = self._rate
        self.width, self.height = self._calibration.depth.resolution_width, self._calibration.depth.resolution_height
        self._clock, self._number, self.dropped = DeviceClock(), 0, 0

    def _take(self, stop: threading.Event) -> Frame | None:
        capture = c_void_p()
        came = self._sdk.k4a_device_get_capture(self._device, byref(capture), WAIT_MS)
        arrival = time.perf_counter()
        if came == native.TIMED_OUT:
            return None
        if came != native.SUCCEEDED:
            raise ConnectionError("the device delivers no more captures; it may have been unplugged")
        try:
            return self._frame(capture, arrival)
        finally:
            self._sdk.k4a_capture_release(capture)

    def _frame(self, capture: c_void_p, arrival: float) -> Frame | None:
        """Copies what a capture holds; None if half of it is missing."""
        sdk = self._sdk
        depth = sdk.k4a_capture_get_depth_image(capture)
        color = sdk.k4a_capture_get_color_image(capture) if self.use_rgb else None
        try:
            if not depth or (self.use_rgb and not color):
                self.dropped += 1
                return None
            self._number += 1
            exposed = sdk.k4a_image_get_device_timestamp_usec(depth) / 1e6
            bgra = native.picture(sdk, color, np.uint8, 4) if color else None
            return Frame(
                self._clock.stamp(exposed, arrival),
                arrival,
                None if bgra is None else np.ascontiguousarray(bgra[..., 2::-1]),
                native.picture(sdk, depth, np.uint16, 1),
                self._number,
            )
        finally:
            for image in filter(None, (depth, color)):
                sdk.k4a_image_release(image)

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            self._sdk.k4a_device_stop_cameras(device)
            self._sdk.k4a_device_close(device)
