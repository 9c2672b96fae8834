"""How a key frame ended, from what a compliant arm feels."""

from __future__ import annotations

import numpy as np
import pytest

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Outcome
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.hardware.backends.franky import OutcomeWatch
from lerobot_adamanip.hardware.backends.franky_options import FrankyOptions

STALL_TICKS = DEFAULT_MOTION.stall_ticks
GOAL = transform((0.5, 0.0, 0.4))
TICK = 0.02


def watch(time_limit: float = 10.0) -> OutcomeWatch:
    return OutcomeWatch(GOAL, FrankyOptions(), 0.0, time_limit)


def behind(lag: float = 0.0, angle: float = 0.0) -> np.ndarray:
    return transform((0.5 - lag, 0.0, 0.4), rotation_about((0, 0, 1), angle))


@pytest.mark.parametrize("pose", [behind(lag=0.031), behind(angle=0.028)])
def test_a_tool_that_is_held_back_for_some_ticks_stalls(pose: np.ndarray) -> None:
    looking = watch()
    outcomes = [looking.look(pose, GOAL, running=True, speed=0.0, now=k * TICK) for k in range(STALL_TICKS)]
    assert outcomes == [None] * (STALL_TICKS - 1) + [Outcome.STALLED]


def test_a_jerk_is_no_stall() -> None:
    looking = watch()
    for k in range(50):
        lag = 0.029 if k % STALL_TICKS == 0 else 0.04
        assert looking.look(behind(lag), GOAL, running=True, speed=0.1, now=k * TICK) is None


def test_a_motion_that_ended_at_its_goal_is_reached_as_soon_as_it_rests() -> None:
    looking = watch()
    assert looking.look(behind(0.001), GOAL, running=False, speed=0.1, now=1.0) is None
    assert looking.look(behind(0.001), GOAL, running=False, speed=0.0, now=1.02) is Outcome.REACHED


def test_an_arm_that_follows_late_gets_half_a_second() -> None:
    for lag, outcome in ((0.011, Outcome.REACHED), (0.02, Outcome.STALLED)):
        looking = watch()
        told = [looking.look(behind(lag), GOAL, running=False, speed=0.0, now=now) for now in (1.0, 1.49, 1.51)]
        assert told == [None, None, outcome]


def test_a_motion_that_begins_late_is_not_taken_for_one_that_ended() -> None:
    looking = watch()
    assert looking.look(behind(0.02), behind(0.02), running=False, speed=0.0, now=0.0) is None
    for k in range(1, 100):
        assert looking.look(behind(0.02), behind(0.02), running=True, speed=0.1, now=k * TICK) is None
    assert looking.look(behind(0.02), GOAL, running=False, speed=0.1, now=2.0) is None


def test_a_motion_without_end_is_given_up() -> None:
    looking = watch(time_limit=2.0)
    assert looking.look(behind(0.01), behind(0.01), running=True, speed=0.1, now=1.99) is None
    assert looking.look(behind(0.01), behind(0.01), running=True, speed=0.1, now=2.01) is Outcome.TIMEOUT
