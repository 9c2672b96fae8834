"""Streaming against a gantry whose every number is known: follows, smooths, stalls, gives way; key frames unchanged."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_driver import STIFFNESS, Gantry, goal

from lerobot_adamanip.contract.keyframes import MotionLimits, Outcome
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.arm_driver import ArmDriver

LIMITS = MotionLimits()
DT = 0.02


class Watched(Gantry):
    """Remembers every commanded joint target."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.targets: list[Any] = []

    def tick(self, target: Any, velocity: Any, finger: float) -> None:
        self.targets.append(target.copy())
        super().tick(target, velocity, finger)


def ticks(driver: ArmDriver, number: int) -> None:
    for _ in range(number):
        driver.stream_tick()


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(0.2, 0.9), st.floats(-0.6, 0.6), st.floats(0.1, 1.0)), min_size=1, max_size=4))
def test_speed_and_acceleration_keep_their_limits_whatever_is_asked(goals: list[tuple[float, float, float]]) -> None:
    gantry = Watched()
    driver = gantry.driver()
    for x, y, z in goals:
        driver.follow_target(goal(x, y, z))
        ticks(driver, 7)
    velocity = np.diff(np.array([goal()[:3], *(target[:3] for target in gantry.targets)]), axis=0) / DT
    assert np.linalg.norm(velocity, axis=1).max() <= LIMITS.linear_speed * 1.001
    change = np.diff(np.vstack([np.zeros(3), velocity]), axis=0) / DT
    assert np.linalg.norm(change, axis=1).max() <= LIMITS.linear_acceleration * 1.001


def test_the_newest_target_wins_and_is_reached_without_overshoot() -> None:
    gantry = Watched()
    driver = gantry.driver()
    driver.follow_target(goal(0.9))
    ticks(driver, 5)
    driver.follow_target(goal(0.6, 0.1))
    ticks(driver, 100)
    np.testing.assert_allclose(driver.measured().tcp_in_base[:3, 3], (0.6, 0.1, 0.7), atol=1e-3)
    assert max(target[0] for target in gantry.targets) < 0.6005
    assert not driver.stalled
    assert not driver.unreachable


def test_without_a_target_the_arm_stays_and_hold_brings_it_to_rest() -> None:
    gantry = Watched()
    driver = gantry.driver()
    ticks(driver, 3)
    np.testing.assert_array_equal(gantry.targets[-1], gantry.targets[0])
    driver.follow_target(goal(0.9))
    ticks(driver, 20)
    driver.hold()
    at = gantry.qpos[0]
    ticks(driver, 50)
    assert np.abs(gantry.qvel).max() < 1e-3
    assert gantry.qpos[0] - at < 0.09  # v^2 / 2a


def test_a_blocked_pull_stalls_at_a_bounded_lag_and_is_given_up_by_going_back() -> None:
    gantry = Watched(wall=0.55)
    driver = gantry.driver()
    driver.follow_target(goal(0.7))
    ticks(driver, 150)
    assert driver.stalled
    lag = gantry.targets[-1][0] - 0.55
    assert LIMITS.stall_position < lag < LIMITS.stall_position + LIMITS.stall_ticks * LIMITS.linear_speed * DT
    np.testing.assert_array_equal(gantry.targets[-1], gantry.targets[-20])  # it holds, and does not creep
    assert driver.effort[0] == pytest.approx(STIFFNESS[0] * lag)
    driver.follow_target(goal(0.52))
    ticks(driver, 100)
    assert not driver.stalled
    assert gantry.qpos[0] == pytest.approx(0.52, abs=1e-3)


def test_out_of_reach_it_says_so_and_stays_where_it_can() -> None:
    gantry = Watched(reach=0.72)
    driver = gantry.driver()
    driver.follow_target(goal(0.8))
    ticks(driver, 100)
    assert driver.unreachable
    driver.follow_target(goal(0.6))
    ticks(driver, 100)
    assert not driver.stalled
    assert not driver.unreachable
    assert gantry.qpos[0] == pytest.approx(0.6, abs=1e-3)


def test_a_malformed_target_is_refused_and_changes_nothing() -> None:
    driver = Watched().driver()
    driver.follow_target(goal(0.6))
    with pytest.raises(ConfigurationError):
        driver.follow_target(np.full(10, np.nan, np.float32))
    ticks(driver, 100)
    assert driver.measured().tcp_in_base[0, 3] == pytest.approx(0.6, abs=1e-3)


def test_key_frames_after_a_stream_are_those_without_one() -> None:
    gantry, plain = Watched(), Watched()
    streaming, stock = gantry.driver(), plain.driver()
    ticks(streaming, 10)
    streaming.end_stream()
    gantry.targets.clear()
    feedback, expected = (driver.execute(goal(0.7, 0.1, 0.8, turn=0.4)) for driver in (streaming, stock))
    assert feedback.outcome is expected.outcome is Outcome.REACHED
    np.testing.assert_array_equal(np.array(gantry.targets), np.array(plain.targets))


def test_a_key_frame_yields_after_each_tick_and_can_be_aborted() -> None:
    gantry = Watched()
    driver = gantry.driver()
    motion = driver.motion(goal(0.9))
    for number in range(1, 6):
        next(motion)
        assert gantry.ticks == number
    motion.close()
    assert driver.feedback.outcome is None
    assert gantry.ticks == 5
