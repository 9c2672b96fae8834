"""How an action is executed, with a stand-in for the arm's process: detours, what is sent."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from filter_fuzz import LIMITS, START

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import Array, pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.hardware.adamanip_franka.adamanip_franka import MotionDriver
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, Execution
from lerobot_adamanip.hardware.robot_registry import RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter


class Arm:
    """Is at once where it is sent."""

    def __init__(self, at: Array) -> None:
        self.at, self.outcomes = at, [Outcome.REACHED] * 9
        self.sent: list[tuple[Execution, np.ndarray]] = []

    def send(self, pose: np.ndarray, execution: Execution) -> int:
        self.sent.append((execution, pose))
        return len(self.sent)

    def wait(self, number: int, time_limit: float) -> Any:
        outcome = self.outcomes.pop(0)
        if outcome is Outcome.REACHED:
            self.at = pose_from_vector(self.sent[number - 1][1])[0]
        return SimpleNamespace(reading=reading(self.at, outcome))

    def healthy(self) -> Any:
        return SimpleNamespace(reading=reading(self.at, None))


def reading(at: Array, outcome: Outcome | None) -> ArmReading:
    seven = np.zeros(7)
    return ArmReading(0.0, 0.0, at, 1.0, seven, seven, seven, ArmMode.IDLE, outcome=outcome)


@pytest.fixture
def arm() -> Arm:
    return Arm(START)


@pytest.fixture
def session() -> RobotSession:
    return RobotSession()


@pytest.fixture
def driver(arm: Arm, session: RobotSession) -> MotionDriver:
    driver = MotionDriver(arm, session, SafetyFilter(LIMITS), Execution.KEYFRAME, 60.0)  # type: ignore[arg-type]
    driver.anchor()
    return driver


def floor(turn: float) -> np.ndarray:
    position = (0.5, 0.0, LIMITS.box_lower[2])
    return pose_vector(transform(position, START[:3, :3] @ rotation_about((0, 0, 1), turn)), 1.0)


def test_a_key_frame_that_turns_at_the_floor_is_sent_in_three_motions(
    driver: MotionDriver, arm: Arm, session: RobotSession
) -> None:
    driver.send(floor(0.0), reading(arm.at, None))
    sent = driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 4
    assert sent.tobytes() == arm.sent[-1][1].tobytes()
    assert session.sent is not None
    assert session.sent.tobytes() == sent.tobytes()
    driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 4  # the same again is no motion


def test_a_detour_that_is_blocked_ends_the_key_frame(driver: MotionDriver, arm: Arm, session: RobotSession) -> None:
    driver.send(floor(0.0), reading(arm.at, None))
    arm.outcomes = [Outcome.STALLED]
    sent = driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 2
    assert sent.tobytes() == arm.sent[-1][1].tobytes()
    assert session.reading is not None
    assert session.reading.outcome is Outcome.STALLED
