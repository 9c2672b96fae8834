"""The gripper's thread: commands only when what is wanted crosses the middle, and no caller ever waits for one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest

from lerobot_adamanip.hardware.backends.gripper import GripperThread
from lerobot_adamanip.util.errors import RobotError


class SlowHand:
    """Waits for `go_on`, and writes down what it was told."""

    def __init__(self, opening: float = 1.0) -> None:
        self.told: list[str] = []
        self.width, self.fails = opening, False
        self.go_on = threading.Event()
        self.go_on.set()

    def open(self) -> None:
        self._do("open", 1.0)

    def close(self) -> None:
        self._do("close", 0.2)

    def _do(self, what: str, width: float) -> None:
        self.told.append(what)
        self.go_on.wait(20)
        if self.fails:
            raise OSError("the hand is gone")
        self.width = width

    def opening(self) -> float:
        return self.width

    def stop(self) -> None:
        self.told.append("stop")
        self.go_on.set()


@pytest.fixture
def hand() -> SlowHand:
    return SlowHand()


@pytest.fixture
def gripper(hand: SlowHand) -> Iterator[GripperThread]:
    thread = GripperThread(lambda: hand)
    thread.start()
    yield thread
    hand.go_on.set()
    thread.close()


def until(condition: Callable[[], bool]) -> None:
    end = time.perf_counter() + 20
    while not condition():
        assert time.perf_counter() < end
        time.sleep(0.005)


def test_a_stream_of_openings_is_few_commands(gripper: GripperThread, hand: SlowHand) -> None:
    for opening in (1.0, 0.9, 0.6, 0.5, 0.46, 0.44, 0.3, 0.0, 0.2, 0.5, 0.54):
        gripper.want(opening)
    until(lambda: not gripper.busy)
    until(lambda: gripper.opening == 0.2)
    assert hand.told == ["close"]
    gripper.want(0.56)
    until(lambda: gripper.opening == 1.0)
    assert hand.told == ["close", "open"]
    assert gripper.commands == 2


def test_wanting_never_waits_only_the_newest_is_carried_out_and_the_fingers_are_seen_meanwhile(
    gripper: GripperThread, hand: SlowHand
) -> None:
    """A command takes up to 0.9 s."""
    hand.go_on.clear()
    gripper.want(0.0)
    until(lambda: hand.told == ["close"])
    began = time.perf_counter()
    for opening in 1000 * (1.0, 0.0, 1.0):
        gripper.want(opening)
    assert (time.perf_counter() - began) / 3000 < 0.005
    for width in (0.8, 0.5, 0.3):
        hand.width = width
        until(lambda width=width: gripper.opening == width)  # type: ignore[misc]
    assert gripper.busy
    hand.go_on.set()
    until(lambda: not gripper.busy)
    assert hand.told == ["close", "open"]
    assert gripper.opening == 1.0


def test_the_first_wish_is_carried_out_unless_fingers_are_wide_open() -> None:
    """Fingers that are closed may not hold: they are told to."""
    for opening, wanted, told in ((1.0, 1.0, []), (0.5, 1.0, ["open"]), (0.0, 0.0, ["close"]), (0.5, 0.5, [])):
        hand = SlowHand(opening)
        gripper = GripperThread(lambda hand=hand: hand)  # type: ignore[misc]
        gripper.start()
        gripper.want(wanted)
        until(lambda gripper=gripper: not gripper.busy)  # type: ignore[misc]
        assert hand.told == told
        gripper.close()


def test_a_hand_that_fails_is_told_and_can_be_forgiven(gripper: GripperThread, hand: SlowHand) -> None:
    hand.fails = True
    gripper.want(0.0)
    until(lambda: not gripper.busy)
    with pytest.raises(RobotError, match="the hand is gone"):
        gripper.check()
    hand.fails = False
    gripper.forgive()
    gripper.check()
    gripper.want(0.0)
    until(lambda: gripper.opening == 0.2)


def test_a_hand_that_is_not_there_is_an_error_of_connecting() -> None:
    def connect() -> SlowHand:
        raise OSError("no hand")

    with pytest.raises(RobotError, match="OSError: no hand"):
        GripperThread(connect).start()


def test_closing_ends_a_command_under_way(gripper: GripperThread, hand: SlowHand) -> None:
    hand.go_on.clear()
    gripper.want(0.0)
    until(lambda: hand.told == ["close"])
    began = time.perf_counter()
    gripper.close()
    assert hand.told[-1] == "stop"
    assert time.perf_counter() - began < 2.0
