"""Streaming against a gantry whose every number is known: follows, smooths, stalls, gives way; key frames unchanged."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_driver import STIFFNESS, Gantry, goal

from lerobot_adamanip.contract.keyframes import MotionLimits, Outcome
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.kinematics import ArmKinematics
from lerobot_env_adamanip.sim.twin.stepped import MotionAbortedError, SteppedMotion
from lerobot_env_adamanip.sim.twin.stream_driver import StreamDriver

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

    def streaming(self) -> StreamDriver:
        return StreamDriver(
            cast(ArmKinematics, self), self.read, self.tick, control_dt=DT, stiffness=STIFFNESS, limits=LIMITS
        )


def ticks(driver: StreamDriver, number: int) -> None:
    for _ in range(number):
        driver.stream_tick()


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(0.2, 0.9), st.floats(-0.6, 0.6), st.floats(0.1, 1.0)), min_size=1, max_size=4))
def test_speed_and_acceleration_keep_their_limits_whatever_is_asked(goals: list[tuple[float, float, float]]) -> None:
    gantry = Watched()
    driver = gantry.streaming()
    for x, y, z in goals:
        driver.follow_target(goal(x, y, z))
        ticks(driver, 7)
    velocity = np.diff(np.array([goal()[:3], *(target[:3] for target in gantry.targets)]), axis=0) / DT
    assert np.linalg.norm(velocity, axis=1).max() <= LIMITS.linear_speed * 1.001
    change = np.diff(np.vstack([np.zeros(3), velocity]), axis=0) / DT
    assert np.linalg.norm(change, axis=1).max() <= LIMITS.linear_acceleration * 1.001


def test_the_newest_target_wins_and_is_reached_without_overshoot() -> None:
    gantry = Watched()
    driver = gantry.streaming()
    driver.follow_target(goal(0.9))
    ticks(driver, 5)
    driver.follow_target(goal(0.6, 0.1))
    ticks(driver, 100)
    np.testing.assert_allclose(driver.measured().tcp_in_base[:3, 3], (0.6, 0.1, 0.7), atol=1e-3)
    assert max(target[0] for target in gantry.targets) < 0.6005
    assert driver.stream_outcome is None


def test_without_a_target_the_arm_stays_and_hold_brings_it_to_rest() -> None:
    gantry = Watched()
    driver = gantry.streaming()
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
    driver = gantry.streaming()
    driver.follow_target(goal(0.7))
    ticks(driver, 150)
    assert driver.stalled
    assert driver.stream_outcome is Outcome.STALLED
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
    driver = gantry.streaming()
    driver.follow_target(goal(0.8))
    ticks(driver, 100)
    assert driver.stream_outcome is Outcome.UNREACHABLE
    driver.follow_target(goal(0.6))
    ticks(driver, 100)
    assert driver.stream_outcome is None
    assert gantry.qpos[0] == pytest.approx(0.6, abs=1e-3)


def test_a_malformed_target_is_refused_and_changes_nothing() -> None:
    driver = Watched().streaming()
    driver.follow_target(goal(0.6))
    with pytest.raises(ConfigurationError):
        driver.follow_target(np.full(10, np.nan, np.float32))
    ticks(driver, 100)
    assert driver.measured().tcp_in_base[0, 3] == pytest.approx(0.6, abs=1e-3)


def test_key_frames_after_a_stream_are_those_of_the_key_frame_driver() -> None:
    """`execute` is not ours: from the same state it commands the same, to the bit."""
    gantry, plain = Watched(), Watched()
    streaming, stock = gantry.streaming(), plain.driver()
    ticks(streaming, 10)
    streaming.end_stream()
    gantry.targets.clear()
    felt, expected = streaming.execute(goal(0.7, 0.1, 0.8, turn=0.4)), stock.execute(goal(0.7, 0.1, 0.8, turn=0.4))
    assert felt.outcome is expected.outcome is Outcome.REACHED
    np.testing.assert_array_equal(np.array(gantry.targets), np.array(plain.targets))


def test_a_stepped_motion_takes_one_tick_a_step_and_ends_as_it_would() -> None:
    done: list[int] = []

    def motion() -> None:
        for number in range(3):
            done.append(number)
            stepped.pause()

    stepped = SteppedMotion(motion)
    seen = []
    while not stepped.step():
        seen.append(list(done))
    assert seen == [[0], [0, 1], [0, 1, 2]]
    assert stepped.step()  # whoever asks again is told again


def test_a_stepped_motion_hands_its_error_on_and_can_be_aborted() -> None:
    def fails() -> None:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        SteppedMotion(fails).step()
    reached: list[str] = []

    def endless() -> None:
        try:
            while True:
                stepped.pause()
        except MotionAbortedError:
            reached.append("aborted")
            raise

    stepped = SteppedMotion(endless)
    stepped.step()
    stepped.abort()
    stepped.abort()
    assert reached == ["aborted"]
    assert stepped.finished
