"""RealSense cameras based on LeRobot's: depth in millimetres, colour and depth of one exposure, timestamps.

LeRobot's class (0.6.1) returns raw sensor counts as millimetres, but a D405 counts 0.1 mm. It stamps pictures at
arrival and reads colour and depth in two calls.
"""

from __future__ import annotations

import logging
import time
from threading import Event
from typing import Any

import numpy as np
from lerobot.cameras.realsense import camera_realsense as stock
from lerobot.cameras.realsense.configuration_realsense import RealSenseCameraConfig
from numpy.typing import NDArray

from lerobot_adamanip.hardware.camera_frames import Frame, Intrinsics
from lerobot_adamanip.hardware.cameras.base import FrameReader, LatestFrame, max_latency
from lerobot_adamanip.hardware.cameras.config_adamanip_realsense import AdamanipRealsenseConfig
from lerobot_adamanip.util.errors import AdaManipError, RobotError

_log = logging.getLogger(__name__)
WAIT_MS = 200
MAX_LATENCY = 1.0
"""Maximum plausible age of a frame at arrival [s]. Otherwise its timestamp is not on the host's clock."""
PINHOLES = ("none", "brown_conrady", "inverse_brown_conrady", "modified_brown_conrady")
"""Distortion models with OpenCV's five coefficients; the last two models match up to second order."""


class AdamanipRealsense(FrameReader, stock.RealSenseCamera):
    """A RealSense camera. LeRobot's class opens, configures and resets it; this class reads frames."""

    def __init__(self, config: AdamanipRealsenseConfig) -> None:
        self.name = config.serial_number_or_name
        self.frames = LatestFrame()
        self._last_number: int | None = None
        self._scale = 1.0
        self._has_warned = False
        super().__init__(RealSenseCameraConfig(**vars(config)))

    def connect(self, warmup: bool = True) -> None:
        """Opens the camera. With ``warmup``, waits for frames and resets it if none come. Raises `RobotError`."""
        try:
            super().connect(warmup)
        except AdaManipError:
            raise
        except Exception as error:  # SDK and LeRobot raise many types
            raise self._error("It cannot be opened.", error, "a camera that is plugged in and free") from error

    def depth_intrinsics(self) -> Intrinsics:
        """Returns the factory calibration of the depth imager. Raises `RobotError` if not connected."""
        return self._intrinsics(stock.rs.stream.depth)

    def color_intrinsics(self) -> Intrinsics:
        """Returns the factory calibration of the colour imager."""
        return self._intrinsics(stock.rs.stream.color)

    def depth_in_color(self) -> NDArray[np.float64] | None:
        """Returns the pose (4, 4) [m] of the depth imager in the colour frame; None unless both are enabled."""
        if not (self.use_rgb and self.use_depth):
            return None
        extrinsics = self._stream(stock.rs.stream.depth).get_extrinsics_to(self._stream(stock.rs.stream.color))
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(extrinsics.rotation, (3, 3)).T  # librealsense stores it column by column
        pose[:3, 3] = extrinsics.translation
        return pose

    def _stream(self, kind: Any) -> Any:
        if self.rs_profile is None:
            raise self._error("It is not connected.", "connect() not called", "connect() first")
        return self.rs_profile.get_stream(kind)

    def _intrinsics(self, kind: Any) -> Intrinsics:
        intrinsics = self._stream(kind).as_video_stream_profile().get_intrinsics()
        if intrinsics.model.name not in PINHOLES:
            raise self._error("Its lens model is no pinhole model.", intrinsics.model.name, ", ".join(PINHOLES))
        matrix = np.array([[intrinsics.fx, 0.0, intrinsics.ppx], [0.0, intrinsics.fy, intrinsics.ppy], [0.0, 0.0, 1.0]])
        return Intrinsics(matrix, np.array(intrinsics.coeffs, np.float64), intrinsics.width, intrinsics.height)

    # Hooks of LeRobot's class ---------------------------------------------------------------------------------------

    def _start_read_thread(self) -> None:
        if self.use_depth:
            assert self.rs_profile is not None
            self._scale = 1e3 * self.rs_profile.get_device().first_depth_sensor().get_depth_scale()
        self._last_number = None
        super()._start_read_thread()

    def _stop_read_thread(self) -> None:
        super()._stop_read_thread()
        self.frames.clear()

    def _run_warmup(self) -> None:
        """Waits for frames. Raises ConnectionError; LeRobot's `connect` then retries and finally resets the camera."""
        end = time.perf_counter() + max(self.warmup_s, 1)
        try:
            self.frame_after(float("-inf"), timeout=end - time.perf_counter())
        except RobotError as error:
            raise ConnectionError(str(error)) from error
        if self.stop_event is not None:
            self.stop_event.wait(end - time.perf_counter())

    def _read_loop(self) -> None:
        self._deliver(self._take, self.stop_event)

    def _take(self, _: Event) -> Frame | None:
        """Returns the next exposure; None if it is incomplete, repeated or not ready."""
        assert self.rs_pipeline is not None
        came, pair = self.rs_pipeline.try_wait_for_frames(timeout_ms=WAIT_MS)
        arrival = time.perf_counter()
        if not came or not pair:
            return None
        color = pair.get_color_frame() if self.use_rgb else None
        depth = pair.get_depth_frame() if self.use_depth else None
        if (self.use_rgb and not color) or (self.use_depth and not depth):
            return None
        first: Any = depth if self.use_depth else color
        number = int(first.get_frame_number())
        if number == self._last_number:  # the pipeline repeats a frame to pair it with a new one of the other imager
            return None
        self._last_number = number
        return Frame(
            self._stamp(first, arrival),
            arrival,
            None if color is None else np.array(color.get_data(), np.uint8),  # copies: the SDK reuses its own
            None if depth is None else self._millimetres(np.asanyarray(depth.get_data())),
            number,
        )

    def _millimetres(self, counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
        if abs(self._scale - 1) < 1e-6:
            return counts.copy()
        depth = np.rint(counts * np.float32(self._scale))
        return np.where(depth <= np.iinfo(np.uint16).max, depth, 0).astype(np.uint16)

    def _stamp(self, frame: Any, arrival: float) -> float:
        """Returns a frame's exposure time. If the SDK does not map the device clock to the host's: its lower bound."""
        latency: float = time.time() - (time.perf_counter() - arrival) - frame.get_timestamp() / 1e3
        if 0 <= latency <= MAX_LATENCY:
            return arrival - latency
        bound = max_latency(self.fps)
        if not self._has_warned:
            self._has_warned = True
            _log.warning(
                "Camera %s: its timestamps are not on this computer's clock, so each picture counts as taken %.2f s "
                "before it arrived. If pictures count as too old: a larger --robot.camera_age",
                self.name,
                bound,
            )
        return arrival - bound
