"""The robot `adamanip_franka_sim`: the class of the real robot with a simulator as the arm process."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path
from typing import Any

from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.hardware.adamanip_franka.adamanip_franka import AdamanipFranka
from lerobot_adamanip.hardware.adamanip_franka.interface import command_rate, interface_of
from lerobot_adamanip.hardware.arm import RESET, ArmReading
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.camera_frames import simulated_calibration
from lerobot_adamanip.hardware.closing import close_all
from lerobot_adamanip.hardware.robot_registry import OPERATOR_SUCCESS, RESET_WANTED, SUCCESS
from lerobot_adamanip.hardware.safety import SafetyLimits
from lerobot_adamanip.util import files
from lerobot_env_adamanip.twin.config_devices import AdamanipFrankaSimConfig
from lerobot_env_adamanip.twin.process import SUCCESS_BOX, TWIN, TwinOptions, frame_capacity
from lerobot_env_adamanip.twin.twin_camera import AdamanipTwin

START_TIME, RESET_TIME = 600.0, 300.0
"""Time limit for the start of the simulator and for a scene reset [s]."""


class AdamanipFrankaSim(AdamanipFranka):
    """The twin, an `EpisodicRobot`. Episode k has seed ``config.seed + k``."""

    config_class = AdamanipFrankaSimConfig
    name = "adamanip_franka_sim"
    config: AdamanipFrankaSimConfig

    def __init__(self, config: AdamanipFrankaSimConfig) -> None:
        interface = interface_of(config)
        config.set_cameras(depth=interface.depth, images=interface.images)
        super().__init__(config)
        self._stands_at(config.seed)

    def _stands_at(self, seed: int) -> None:
        """Stores that the scene of a seed is loaded and untouched."""
        self._seed, self._moved = seed, False
        self._sent, self._over = 0, False

    # Connection ------------------------------------------------------------------------------------------------------

    @property
    def is_calibrated(self) -> bool:
        """Always True: the twin process provides the calibration."""
        return True

    def calibrate(self) -> None:
        """Does nothing: there is nothing to calibrate."""

    def _make_client(self) -> ArmClient:
        config, environment = self.config, self.config.environment()
        lockstep = config.clock == "lockstep"
        return ArmClient(
            TWIN,
            TwinOptions(environment, config.seed, environment.images_from, lockstep),
            server=self._server_options(command_rate(config) if lockstep else None),
            frames={**dict.fromkeys(self._twin_cameras, frame_capacity(environment.image_size)), SUCCESS_BOX: 64},
            connect_time=START_TIME,
        )

    @property
    def _twin_cameras(self) -> dict[str, AdamanipTwin]:
        return {name: camera for name, camera in self.cameras.items() if isinstance(camera, AdamanipTwin)}

    def _open_session(self, limits: SafetyLimits, details: dict[str, Any]) -> None:
        super()._open_session(limits, details)
        self._stands_at(self.config.seed)
        self._calibrated(details)
        assert self._client is not None
        size, lockstep = self.config.environment().image_size, self.config.clock == "lockstep"
        for name, camera in self._twin_cameras.items():
            camera.attach(self._client, name, size=size, lockstep=lockstep)

    def _calibrated(self, details: dict[str, Any]) -> None:
        self._on_hand.clear()
        if FRONT in self._twin_cameras:
            self._session.calibrations[FRONT] = simulated_calibration(details["camera"], "twin")

    def _read_calibrations(self) -> None:
        """Does nothing: the twin process provides the calibration."""

    def disconnect(self) -> None:
        """Disconnects. First logs an episode outside a recording to ``episode_log``."""
        close_all([self._log_last_episode, super().disconnect])

    def _log_last_episode(self) -> None:
        moved, self._moved = self._moved, False
        if self.is_connected and moved and self.config.episode_log is not None:
            self._log(Path(self.config.episode_log), None)

    # Observation and action ------------------------------------------------------------------------------------------

    def get_observation(self) -> dict[str, Any]:
        """Returns state and images. First resets the scene if the operator requests it."""
        if self._session.details.pop(RESET_WANTED, False):
            self.put_up(self._seed)
            self._session.episodes += 1
        return super().get_observation()

    def _stamp(self, reading: ArmReading) -> float:
        # in lockstep, equal steps give equal data
        return reading.robot_time if self.config.clock == "lockstep" else super()._stamp(reading)

    def _measure_success(self) -> None:
        self._session.details[SUCCESS] = self._succeeded()

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Sends an action. It has no effect after the end of a key-frame episode, or after ``end_when_done``."""
        if self._over:
            return action
        self._moved = True
        sent: dict[str, float] = super().send_action(action)
        is_key_frame, ends = self.config.execution == "keyframe", self.config.end_when_done
        self._sent += 1
        is_last = is_key_frame and self._sent >= self.config.max_key_frames
        self._over = (is_key_frame or ends) and (is_last or self._succeeded())
        if self._over and ends:
            signal.raise_signal(signal.SIGINT)
        return sent

    def _succeeded(self) -> bool:
        assert self._client is not None
        success = self._client.frame(SUCCESS_BOX)
        return success is not None and bool(success[1])

    # Episodes --------------------------------------------------------------------------------------------------------

    @property
    def resets_itself(self) -> bool:
        """Always True: no person needs to reset the scene."""
        return True

    def put_up(self, seed: int) -> None:
        """Resets to the scene of a seed. Raises `RobotError`."""
        assert self._client is not None
        scene = self._client.request(RESET, {"seed": seed}, time_limit=RESET_TIME)
        details = self._session.details
        details.pop(OPERATOR_SUCCESS, None)
        details.update(scene)
        self._calibrated(scene)
        self._motion.anchor()
        self._motion.rested_at = time.perf_counter()  # earlier pictures show the scene before
        self._stands_at(seed)

    def begin_episode(self, index: int) -> None:
        """Resets to the scene of episode ``index``, unless it is loaded and untouched."""
        seed = self.config.seed + index
        if self._moved or seed != self._seed:
            self.put_up(seed)

    def end_episode(self, index: int, root: Path) -> None:
        """Logs the episode to ``episode_log`` or next to its dataset. For equal numbers the last line counts."""
        if self.is_connected:
            log = self.config.episode_log
            self._log(Path(log) if log is not None else root.with_name(f"{root.name}.episodes.jsonl"), index)

    def _log(self, path: Path, index: int | None) -> None:
        assert self._client is not None
        result = self._client.request("episode", time_limit=RESET_TIME)
        files.append_line(path, json.dumps({"episode": index, **result, "key_frames": self._sent}))
