"""How an action is executed, with a stand-in for the arm's process: key frame or stream, detours, what is sent."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from filter_fuzz import LIMITS, START

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import Array, pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.hardware.adamanip_franka import motion
from lerobot_adamanip.hardware.adamanip_franka.motion import MotionDriver, MotionRules
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, Execution
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter


class Clock:
    """Stands in for the module `time`."""

    now = 100.0

    def perf_counter(self) -> float:
        return self.now


class Arm:
    """Is at once where it is sent; a key frame takes 5 s."""

    is_connected = True

    def __init__(self, clock: Clock, at: Array) -> None:
        self.clock, self.at, self.outcomes = clock, at, [Outcome.REACHED] * 9
        self.sent: list[tuple[Execution, np.ndarray]] = []

    def send(self, pose: np.ndarray, execution: Execution) -> int:
        self.sent.append((execution, pose))
        return len(self.sent)

    def wait(self, number: int, time_limit: float) -> Any:
        self.clock.now += 5.0
        outcome = self.outcomes.pop(0)
        if outcome is Outcome.REACHED:
            self.at = pose_from_vector(self.sent[number - 1][1])[0]
        return SimpleNamespace(reading=reading(self.at, outcome))

    def healthy(self) -> Any:
        return SimpleNamespace(reading=reading(self.at, None))


def reading(at: Array, outcome: Outcome | None) -> ArmReading:
    seven = np.zeros(7)
    return ArmReading(0.0, 0.0, at, 1.0, seven, seven, seven, ArmMode.IDLE, outcome=outcome)


def driving(
    monkeypatch: pytest.MonkeyPatch, execution: str, at: Array = START
) -> tuple[MotionDriver, Arm, Clock, RobotSession]:
    clock, session = Clock(), RobotSession()
    monkeypatch.setattr(motion, "time", clock)
    arm = Arm(clock, at)
    driver = MotionDriver(arm, session, SafetyFilter(LIMITS), MotionRules(execution, 0, 60.0))  # type: ignore[arg-type]
    driver.anchor()
    return driver, arm, clock, session


def moved(x: float = 0.0, turn: float = 0.0) -> np.ndarray:
    return pose_vector(transform(START[:3, 3] + (x, 0, 0), START[:3, :3] @ rotation_about((0, 0, 1), turn)), 1.0)


@pytest.mark.parametrize("fps", [60, 30, 20, 15, 10, 5])
def test_auto_streams_what_a_teleoperator_asks_for_at_any_rate(monkeypatch: pytest.MonkeyPatch, fps: int) -> None:
    driver, arm, clock, _ = driving(monkeypatch, "auto")
    x = turn = 0.0
    driver.send(moved(), reading(arm.at, None))
    for _ in range(20):
        clock.now += 1 / fps
        x += LIMITS.speed * min(1 / fps, LIMITS.max_dt)
        turn += LIMITS.angular_speed * min(1 / fps, LIMITS.max_dt)
        arm.at = pose_from_vector(driver.send(moved(x, turn), reading(arm.at, None)))[0]
    assert {execution for execution, _ in arm.sent} == {Execution.STREAM}


@pytest.mark.parametrize(("fps", "x", "turn"), [(30, 0.008, 0.0), (30, 0.0, 0.035), (10, 0.03, 0.0), (10, 0.0, 0.2)])
def test_auto_takes_what_is_farther_or_turned_more_for_a_key_frame(
    monkeypatch: pytest.MonkeyPatch, fps: int, x: float, turn: float
) -> None:
    driver, arm, clock, _ = driving(monkeypatch, "auto")
    driver.send(moved(), reading(arm.at, None))
    for count in (1, 2, 3):  # the time that a key frame takes is none between two actions
        clock.now += 1 / fps
        driver.send(moved(count * x, count * turn), reading(arm.at, None))
    assert [execution for execution, _ in arm.sent] == [Execution.STREAM, *[Execution.KEYFRAME] * 3]


def test_auto_counts_steps_where_time_passes_by_them(monkeypatch: pytest.MonkeyPatch) -> None:
    driver, arm, clock, session = driving(monkeypatch, "auto")
    session.details[LOCKSTEP_DT] = 1 / 30
    clock.now += 60.0  # a slow machine
    driver.send(moved(0.006), reading(arm.at, None))
    assert arm.sent[-1][0] is Execution.KEYFRAME


def floor(turn: float) -> np.ndarray:
    position = (0.5, 0.0, LIMITS.box_lower[2])
    return pose_vector(transform(position, START[:3, :3] @ rotation_about((0, 0, 1), turn)), 1.0)


def test_a_key_frame_that_turns_at_the_floor_is_sent_in_three_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    driver, arm, _, session = driving(monkeypatch, "keyframe")
    driver.send(floor(0.0), reading(arm.at, None))
    sent = driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 4
    assert sent.tobytes() == arm.sent[-1][1].tobytes()
    assert session.sent is not None
    assert session.sent.tobytes() == sent.tobytes()
    driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 4  # the same again is no motion


def test_a_detour_that_is_blocked_ends_the_key_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    driver, arm, _, session = driving(monkeypatch, "keyframe")
    driver.send(floor(0.0), reading(arm.at, None))
    arm.outcomes = [Outcome.STALLED]
    sent = driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 2
    assert sent.tobytes() == arm.sent[-1][1].tobytes()
    assert session.reading is not None
    assert session.reading.outcome is Outcome.STALLED
