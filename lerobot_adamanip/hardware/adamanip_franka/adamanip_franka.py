"""The robot `adamanip_franka`: the environment's action and state, on an arm that runs in a separate process."""

from __future__ import annotations

import logging
import shlex
import time
from dataclasses import fields
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots.robot import Robot
from numpy.typing import NDArray

from lerobot_adamanip.contract.control import ACTION_NAMES, DENSE, KEYFRAME, STATES
from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.memory import EVENTS, MEMORY_NAMES
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.episode.memory import Memory
from lerobot_adamanip.hardware import ON_CREATION
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
from lerobot_adamanip.hardware.adamanip_franka.execution_check import check_caller
from lerobot_adamanip.hardware.adamanip_franka.interface import adopt_training_rate, command_rate, interface_of
from lerobot_adamanip.hardware.adamanip_franka.observed import camera_features, check_cameras, pictures
from lerobot_adamanip.hardware.arm import ArmReading, Execution, ServerOptions
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.backends.franky_options import FrankyOptions
from lerobot_adamanip.hardware.calibration.on_hand import CameraOnHand
from lerobot_adamanip.hardware.camera_frames import read_calibrations
from lerobot_adamanip.hardware.closing import close_all, closing_on_error
from lerobot_adamanip.hardware.dense_kinds import decode_action
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, ROBOTS, RobotSession
from lerobot_adamanip.hardware.safety import Corner, SafetyFilter, SafetyLimits
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

_log = logging.getLogger(__name__)
FRANKY = "lerobot_adamanip.hardware.backends.franky:serve_franky"


class SlowLoopFilter(logging.Filter):
    """Drops the slow-loop warning of LeRobot 0.6.1 and later. In lockstep it is a false alarm."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Returns whether to write a log record."""
        return not str(record.msg).startswith(("Record loop is running slower", "Control loop is running slower"))


class MotionDriver:
    """Executes actions as key frames or as a stream on one connected arm, and updates its session.

    Args:
        arm: connected client.
        session: stores every reading and sent target.
        safety: filter of this arm only.
        execution: mode of all actions.
        motion_time: maximum duration of a key frame [s].

    Attributes:
        rested_at: end of the latest key frame, `time.perf_counter()` [s]; None during streaming.
    """

    def __init__(
        self, arm: ArmClient, session: RobotSession, safety: SafetyFilter, execution: Execution, motion_time: float
    ) -> None:
        self._arm, self._session, self._filter = arm, session, safety
        self._execution, self._motion_time = execution, motion_time
        self.rested_at: float | None = None
        self._sent_at: float | None = None
        self._last_request: bytes | None = None

    def read(self) -> ArmReading:
        """Returns the reading of a healthy arm. Raises `RobotError` for a fault."""
        reading = self._arm.healthy().reading
        assert reading is not None
        self._session.reading = reading
        return reading

    def anchor(self, gripper: float | None = None) -> None:
        """Sets the last sent target to the measured pose, and to an opening or, by default, the measured one.

        Raises:
            RobotError: the arm has a fault, or the hand is outside the box.
        """
        reading = self.read()
        self._session.sent = self._filter.anchor(reading.tcp_in_base, reading.gripper if gripper is None else gripper)
        self._sent_at = self.rested_at = self._last_request = None

    def recover(self) -> None:
        """Clears a fault without motion. The next action starts at the current pose, with the commanded gripper.

        Raises `RobotError`.
        """
        self._arm.request("recover")
        sent = self._session.sent
        self.anchor(None if sent is None else float(sent[GRIPPER_DIM]))

    def send(self, target: Target, reading: ArmReading) -> Target:
        """Filters and sends a target (10,), and returns the filtered target. Waits for the end of a key frame.

        Raises:
            RobotError: the arm has a fault, ten targets in a row were malformed, or a key frame does not end.
        """
        send = self._send_keyframe if self._execution is Execution.KEYFRAME else self._send_stream
        self._session.sent = send(target, reading)
        return self._session.sent

    def _send_keyframe(self, target: Target, reading: ArmReading) -> Target:
        """Executes one motion to its end. Skips a repeated goal: a paused rollout resends its last action."""
        sent = self._session.sent
        assert sent is not None, "connecting anchors the filter"
        if self._last_request == target.tobytes():
            return sent
        for sent in self._filter.keyframe(target, reading.tcp_in_base):
            self._session.sent = sent
            end = self._arm.wait(self._arm.send(sent, Execution.KEYFRAME), self._motion_time)
            self._session.reading, self._last_request = end.reading, target.tobytes()
            self.rested_at = time.perf_counter()
            if end.reading is None or end.reading.outcome is not Outcome.REACHED:
                self._filter.give_up_after(sent)  # from here the rest of the path may leave the box
                break
        return sent

    def _send_stream(self, target: Target, reading: ArmReading) -> Target:
        now = time.perf_counter()
        dt = 0.0 if self._sent_at is None else self._session.details.get(LOCKSTEP_DT, now - self._sent_at)
        sent = self._filter.stream(target, reading.tcp_in_base, dt)
        self._arm.send(sent, Execution.STREAM)
        self._sent_at, self.rested_at, self._last_request = now, None, None
        return sent


class AdamanipFranka(Robot):
    """A Franka with its hand. Subclasses override which process is started (`_make_client`)."""

    config_class = AdamanipFrankaConfig
    name = "adamanip_franka"

    def __init__(self, config: AdamanipFrankaConfig) -> None:
        super().__init__(config)
        for call in ON_CREATION:
            call()
        self.config = config
        self.interface = interface_of(config)
        self.cameras = make_cameras_from_configs(config.cameras)
        self._client: ArmClient | None = None
        self._driver: MotionDriver | None = None
        self._session = RobotSession()
        self._on_hand: dict[str, CameraOnHand] = {}
        self._slow_loop = SlowLoopFilter()
        self._connected_at = 0.0

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """State, memory and camera images. LeRobot makes all of them policy inputs."""
        memory = MEMORY_NAMES if self.config.memory == EVENTS else ()
        numbers = dict.fromkeys((*STATES[self.interface.state], *memory), float)
        return {**numbers, **camera_features(self.cameras, depth=self.interface.depth)}

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Action, see `contract.control.ACTION_NAMES`."""
        return dict.fromkeys(ACTION_NAMES[self.interface.action], float)

    @property
    def session(self) -> RobotSession:
        """Shared state for teleoperators and policies in this process."""
        return self._session

    # Calibration ------------------------------------------------------------------------------------------------------

    @property
    def calibration_file(self) -> Path:
        """Path of the camera calibration. Not ``<id>.json``: LeRobot would parse that as motor calibration and fail."""
        return Path(self.calibration_dir) / f"{self.id}.cameras.json"

    @property
    def is_calibrated(self) -> bool:
        """Whether the calibration file contains every depth camera."""
        keys = {key for key, camera in self.cameras.items() if getattr(camera, "use_depth", False)}
        return not keys or (self.calibration_file.is_file() and keys <= set(read_calibrations(self.calibration_file)))

    def calibrate(self) -> None:
        """Reloads the camera calibration. Raises `RobotError` if it is incomplete."""
        if not self.is_calibrated:
            raise RobotError(
                "The cameras of this robot are not calibrated.",
                got=f"no complete {self.calibration_file}",
                allowed="a calibration of every camera with depth",
                hint=f"adamanip calibrate views --record robot.json --out {shlex.quote(str(self.calibration_file))}",
            )
        self._read_calibrations()

    def _warn_if_uncalibrated(self) -> None:
        """Warns once if depth cannot become clouds: no calibration, or one of another picture size."""
        problems = [] if self.is_calibrated else [f"no complete {self.calibration_file}"]
        for key, calibration in self._session.calibrations.items():
            camera, depth = self.cameras.get(key), calibration.depth
            if getattr(camera, "use_depth", False) and (depth.width, depth.height) != (camera.width, camera.height):
                problems.append(f"{key}: {camera.width} x {camera.height}, calibrated {depth.width} x {depth.height}")
        if problems:
            _log.warning(
                "Depth is recorded without a calibration that fits (%s), so `adamanip keyframes` needs --calibration "
                "FILE. See docs/robot.md, step 4.",
                "; ".join(problems),
            )

    def _correct_calibration(self, key: str, depth: NDArray[np.uint16], reading: ArmReading) -> None:
        """Corrects the calibration of a resting camera by the hand in its depth (H, W) [mm]."""
        known = self._session.calibrations.get(key)
        if known is not None and known.depth_in_base is not None:
            if key not in self._on_hand:
                self._on_hand[key] = CameraOnHand(known)
            self._on_hand[key].update(depth, reading)
            self._session.calibrations[key] = self._on_hand[key].corrected()

    def _read_calibrations(self) -> None:
        self._on_hand.clear()
        if self.calibration_file.is_file():
            self._session.calibrations.update(read_calibrations(self.calibration_file))

    def configure(self) -> None:
        """Does nothing: the arm process configures the arm when it connects."""

    # Connection -------------------------------------------------------------------------------------------------------

    @property
    def is_connected(self) -> bool:
        """Whether the arm process runs. The arm may still have a fault."""
        return self._client is not None and self._client.is_connected

    def connect(self, calibrate: bool = True) -> None:
        """Starts the arm process, then the cameras. The arm does not move.

        Args:
            calibrate: whether to warn if recorded depth has no calibration that fits.

        Raises:
            RobotError: already connected, the arm or a camera does not answer, or the hand is outside the box.
            ConfigurationError: a required option is missing, a camera cannot be used, or the policy of this command
                needs the other execution mode or sends deltas more than once.
        """
        if self._client is not None:
            raise RobotError(f"{self} is connected already.")
        check_caller(self.config, self.interface.action)
        adopt_training_rate(self.config)
        check_cameras(self.cameras, key_frames=self.config.execution == Execution.KEYFRAME)
        limits = self._safety_limits()
        self._client = self._make_client()
        with closing_on_error(self.disconnect):
            description = self._client.connect()
            self._open_session(limits, description)
            for camera in self.cameras.values():
                camera.connect()
        if calibrate and self.interface.depth:
            self._warn_if_uncalibrated()

    def _open_session(self, limits: SafetyLimits, details: dict[str, Any]) -> None:
        self._connected_at = time.perf_counter()
        self._session = ROBOTS.open(self._registry_id)
        self._session.safety, self._session.details = limits, dict(details)
        assert self._client is not None
        if (fps := self._client.server.lockstep_fps) is not None:
            self._session.details[LOCKSTEP_DT] = 1 / fps
            for handler in logging.getLogger().handlers:
                handler.addFilter(self._slow_loop)
        self._session.execution = execution = Execution(self.config.execution)
        self._session.action, self._session.state = self.interface.action, self.interface.state
        if self.config.memory == EVENTS:
            is_dense = execution is Execution.STREAM
            rate = round(command_rate(self.config))
            self._session.memory = Memory(
                control=DENSE if is_dense else KEYFRAME, action=self.interface.action, fps=rate
            )
        time_limit = self.config.motion_time
        self._driver = MotionDriver(self._client, self._session, SafetyFilter(limits), execution, time_limit)
        if self.config.recover_on_connect:
            self._driver.recover()
        else:
            self._driver.anchor()
        self._read_calibrations()

    def _safety_limits(self) -> SafetyLimits:
        config = self.config
        if config.box_lower is None or config.box_upper is None:
            raise ConfigurationError(
                "The box that the hand must stay in is missing.",
                got=f"box_lower={config.box_lower}, box_upper={config.box_upper}",
                allowed="two corners [m, base frame]; no default is safe on every table",
                hint="--robot.box_lower='[0.3, -0.4, 0.0]' --robot.box_upper='[0.8, 0.4, 0.7]', see docs/robot.md",
            )
        lower, upper = (tuple(map(float, corner)) for corner in (config.box_lower, config.box_upper))
        rest = {name: getattr(config, name) for name in ("speed", "angular_speed", "lead")}
        return SafetyLimits(cast("Corner", lower), cast("Corner", upper), **rest)

    def _make_client(self) -> ArmClient:
        """Returns the arm process, not yet started. Raises `ConfigurationError`. A twin overrides it."""
        config = self.config
        options = FrankyOptions(**{field.name: getattr(config, field.name) for field in fields(FrankyOptions)})
        options.check()
        if (force := config.lead * config.stiffness) >= config.collision_force:
            raise ConfigurationError(
                "A teleoperated pull would trigger the arm's reflex.",
                got=f"lead {config.lead:g} m x stiffness {config.stiffness:g} N/m = {force:g} N",
                allowed=f"below collision_force ({config.collision_force:g} N)",
                hint="a smaller --robot.lead or --robot.stiffness",
            )
        return ArmClient(FRANKY, options, server=self._server_options())

    def _server_options(self, lockstep_fps: float | None = None) -> ServerOptions:
        """Returns the watchdog settings of the arm process."""
        config = self.config
        return ServerOptions(config.state_age, config.command_age, lockstep_fps, self._safety_limits())

    def disconnect(self) -> None:
        """Stops the arm and ends its process within 2 s, then stops all cameras. Idempotent.

        If cameras fail, the first error is raised after all of them were stopped.
        """
        client, self._client, self._driver = self._client, None, None
        if client is not None:
            cameras = (partial(_stop, camera) for camera in self.cameras.values())
            close_all([client.close, self._close_session, *cameras])

    def _close_session(self) -> None:
        for handler in logging.getLogger().handlers:
            handler.removeFilter(self._slow_loop)
        ROBOTS.close(self._registry_id)

    @property
    def _registry_id(self) -> str:
        return self.id or self.name

    @property
    def _motion(self) -> MotionDriver:
        if self._driver is None:
            raise RobotError(f"{self} is not connected.")
        return self._driver

    # Observation and action -------------------------------------------------------------------------------------------

    def get_observation(self) -> dict[str, Any]:
        """Returns state and images. After a key frame, the images were exposed after the arm came to rest.

        Raises:
            RobotError: the arm has a fault, or its process or a camera does not answer.
        """
        reading = self._motion.read()
        observation: dict[str, Any] = self._session.observe(reading, self._stamp(reading))
        for key, camera in self.cameras.items():
            images = pictures(key, camera, max_age=self.config.camera_age, after=self._motion.rested_at)
            if self.config.self_calibration and (depth := images.get(f"{key}{DEPTH_SUFFIX}")) is not None:
                self._correct_calibration(key, depth[..., 0], reading)
            observation |= {name: image for name, image in images.items() if name in self.observation_features}
        return observation

    def _stamp(self, reading: ArmReading) -> float:
        """Returns the measurement time since connection [s]."""
        return reading.stamp - self._connected_at

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Sends an action through the safety filter and returns the filtered action.

        A delta counts from the latest observation's pose, which the policy or teleoperator has seen.

        Raises:
            RobotError: the arm has a fault, ten actions in a row were malformed, or a key frame does not end.
            ConfigurationError: the action lacks a name.
        """
        observed = self._session.reading or self._motion.read()
        target = decode_action(action, observed, self.interface.action)
        sent = self._motion.send(target, self._motion.read())
        self._measure_success()
        return self._session.act(sent, observed)

    def _measure_success(self) -> None:
        """Updates the session's success. A twin overrides it; on a real arm only the operator knows."""

    def recover(self) -> None:
        """Clears a fault without motion. The next action starts at the current pose. Raises `RobotError`."""
        self._motion.recover()


def _stop(camera: Camera) -> None:
    if camera.is_connected:
        camera.disconnect()
