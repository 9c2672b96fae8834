"""The arm's server and its client without processes: what a target is checked for, floods of requests, last words."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fake_arm import START_ROTATION, FakeBackend, FakeOptions

from lerobot_adamanip.contract.rotations import pose_vector, rotation_about, transform
from lerobot_adamanip.hardware.arm import ArmTarget, Execution, Reply, Request, Served, ServerOptions
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.arm_process.mailbox import create_memory, encode, map_mailboxes
from lerobot_adamanip.hardware.arm_process.server import ArmServer, malformed
from lerobot_adamanip.hardware.safety import SafetyLimits

OPTIONS = ServerOptions(limits=SafetyLimits((0.2, -0.4, 0.0), (0.8, 0.4, 0.7), lead=0.04, angular_lead=0.15))
HERE = transform((0.5, 0.0, 0.4), START_ROTATION)


def refused(position: tuple[float, float, float], execution: Execution, turn: float = 0.0) -> str | None:
    tool = transform(position, START_ROTATION @ rotation_about((0, 0, 1), turn))
    return malformed(ArmTarget(pose_vector(tool, 1.0), execution, 0.0), OPTIONS, HERE)


@pytest.mark.parametrize(
    ("position", "execution", "turn", "message"),
    [
        ((0.5, 0.0, 0.35), Execution.STREAM, 0.0, None),
        ((0.5, 0.0, 0.3), Execution.STREAM, 0.0, "jumps"),
        ((0.5, 0.0, 0.4), Execution.STREAM, 0.4, "jumps"),
        ((0.7, 0.2, 0.1), Execution.KEYFRAME, 1.0, None),  # a whole motion may be far
        ((0.5, 0.0, 0.02), Execution.KEYFRAME, 0.0, None),
        ((0.5, 0.0, 0.02), Execution.KEYFRAME, np.pi / 2, "hand outside the box"),  # the tool is inside, a corner not
        ((0.5, 0.0, 0.01), Execution.KEYFRAME, 0.0, "hand outside the box"),
    ],
)
def test_the_server_bounds_jumps_and_the_hands_corners_itself(
    position: tuple[float, float, float], execution: Execution, turn: float, message: str | None
) -> None:
    problem = refused(position, execution, turn)
    assert (problem is None) if message is None else (problem is not None and message in problem)


@pytest.mark.parametrize(("values", "message"), [({2: np.nan}, "no pose"), ({3: 0.5}, "rotation is none")])
def test_the_server_takes_poses_only(values: dict[int, float], message: str) -> None:
    pose = pose_vector(HERE, 1.0)
    pose[list(values)] = list(values.values())
    assert message in str(malformed(ArmTarget(pose, Execution.KEYFRAME, 0.0), OPTIONS, HERE))


class Flood:
    """A connection that has always one more request."""

    def __init__(self) -> None:
        self.asked = self.answered = 0

    def poll(self, _: float = 0.0) -> bool:
        return self.asked < 100_000

    def recv_bytes(self) -> bytes:
        self.asked += 1
        return encode(Request(self.asked, "targets"))

    def send_bytes(self, _: bytes) -> None:
        self.answered += 1


@pytest.fixture
def server() -> Any:
    backend, flood = FakeBackend(FakeOptions()), Flood()
    capacities = {"command": 1024, "status": 16384}
    memory = create_memory(capacities)
    boxes = map_mailboxes(memory, capacities)
    os.close(memory)
    return ArmServer(Served(backend, {"targets": backend.targets}), flood, boxes, ServerOptions()), flood  # type: ignore[arg-type]


def test_a_flood_of_requests_leaves_the_ticks_their_time(server: tuple[ArmServer, Flood]) -> None:
    arm, flood = server
    due = time.perf_counter() + 0.05
    arm._answer(due)
    assert time.perf_counter() - due < 0.5
    assert 0 < flood.answered < 100_000
    answered = flood.answered
    arm._answer(time.perf_counter() - 1.0)  # a tick that is late already: requests are not starved either
    assert flood.answered == answered + 1


class Replies:
    """The client's end of a connection on which one reply lies ready."""

    def __init__(self) -> None:
        self.ready = [Reply(1, "it broke")]

    def poll(self, _: float = 0.0) -> bool:
        return bool(self.ready)

    def recv_bytes(self) -> bytes:
        return encode(self.ready.pop())


def in_another_thread(call: Callable[[], Any]) -> Any:
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(call()))
    thread.start()
    thread.join(5.0)
    assert found, "it waits"
    return found[0]


def test_last_words_are_not_read_while_another_thread_waits_for_an_answer() -> None:
    client = ArmClient("none")
    client._connection = replies = Replies()  # type: ignore[assignment]
    with client._lock:  # as `request` does while it waits
        assert "it broke" not in in_another_thread(lambda: client._last_words("has ended"))
        assert replies.ready
    assert "it broke" in client._last_words("has ended")
    client._connection = None
