"""A robot of LeRobot that tells what ours do, and who moves it: `lerobot-record` imports this as a plugin.

`SAVED`, a file named by an environment variable, gets a line whenever the saving of an episode has ended.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.robots import Robot, RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from lerobot_adamanip import lerobot_patches
from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, POSE, STATES
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.dense_kinds import decode_action, encode_action
from lerobot_adamanip.hardware.robot_registry import ROBOTS

__path__: list[str] = []  # LeRobot imports plugins as packages
SAVED = "RECORDED_ROBOT_SAVED"
SIZE = 64


def goal_at(tick: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    turned = rotation_about((0, 0, 1), 0.2 * np.sin(0.05 * tick))
    return pose_vector(transform((0.5, 0.1 * np.sin(0.1 * tick), 0.7), turned), 1.0)


class Device:
    """What LeRobot asks of robots and teleoperators alike."""

    action_features = dict.fromkeys(ACTION_NAMES[EE_DELTA], float)
    is_calibrated, is_connected, tick = True, False, 0

    def connect(self, calibrate: bool = True) -> None:
        self.is_connected = True

    def disconnect(self) -> None:
        self.is_connected = False

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...


@RobotConfig.register_subclass("recorded_robot")
@dataclass
class RecordedRobotConfig(RobotConfig):
    pass


class RecordedRobot(Device, Robot):
    config_class, name = RecordedRobotConfig, "recorded_robot"
    observation_features: ClassVar[dict[str, Any]] = dict.fromkeys(STATES[POSE], float)
    observation_features |= {"front": (SIZE, SIZE, 3), "front_depth": (SIZE, SIZE, 1)}
    cameras = dict.fromkeys(["front"])

    def connect(self, calibrate: bool = True) -> None:
        super().connect()
        self.session = ROBOTS.open(self.name)
        self.session.action, self.session.state = EE_DELTA, POSE

    def get_observation(self) -> dict[str, Any]:
        pose, gripper = pose_from_vector(goal_at(self.tick - 2))
        seven = np.zeros(7)
        reading = ArmReading(0.0, 0.0, pose, gripper, seven, seven, seven, ArmMode.IDLE)
        shade = np.full((SIZE, SIZE, 3), self.tick % 200, np.uint8)
        depth = np.full((SIZE, SIZE, 1), 600 + self.tick % 200, np.uint16)
        return {**self.session.observe(reading, self.tick / 30.0), "front": shade, "front_depth": depth}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        self.tick += 1
        reading = self.session.reading
        assert reading is not None
        return self.session.act(decode_action(action, reading, EE_DELTA), reading)


@TeleoperatorConfig.register_subclass("recorded_teleop")
@dataclass
class RecordedTeleopConfig(TeleoperatorConfig):
    pass


class RecordedTeleop(Device, Teleoperator):
    config_class, name = RecordedTeleopConfig, "recorded_teleop"
    feedback_features: ClassVar[dict[str, Any]] = {}

    def get_action(self) -> dict[str, Any]:
        self.tick += 1
        session = ROBOTS.find()
        assert session is not None
        assert session.reading is not None
        return encode_action(EE_DELTA, goal_at(self.tick), session.reading)

    def send_feedback(self, feedback: dict[str, Any]) -> None: ...


def _tell(saved: Path) -> None:
    """Writes a line after each saving, so that a test knows which have ended."""
    stock = LeRobotDataset.save_episode

    def save_episode(self: Any, *args: Any, **kwargs: Any) -> None:
        rows = self.writer.episode_buffer["size"]
        stock(self, *args, **kwargs)
        with saved.open("a") as file:
            file.write(f"{self.meta.total_episodes - 1} {rows}\n")
            file.flush()

    LeRobotDataset.save_episode = save_episode


lerobot_patches.apply()  # before the lines: it rehearses with two episodes of its own
if SAVED in os.environ:
    _tell(Path(os.environ[SAVED]))
