"""Arms of tests: the fake in its own process, with watchdogs that a busy machine does not set off."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from fake_arm import FakeOptions
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.hardware.arm import ArmStatus, ServerOptions
from lerobot_adamanip.hardware.arm_process.client import ArmClient

FAKE = "fake_arm:serve_fake"
PATIENT = ServerOptions(state_age=5.0, command_age=0.5)
LOCKSTEP = ServerOptions(lockstep_fps=30.0)


class FakeArm(ArmClient):
    """Connected within its context."""

    def __enter__(self) -> ArmClient:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def fake_arm(server: ServerOptions = PATIENT, **options: Any) -> FakeArm:
    return FakeArm(FAKE, FakeOptions(**options), server=server, connect_time=60.0)


def eventually(client: ArmClient, condition: Callable[[ArmStatus], bool], seconds: float = 10.0) -> ArmStatus:
    """The first status that meets a condition."""
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        status = client.status()
        if condition(status):
            return status
        time.sleep(0.005)
    raise AssertionError(f"never: {status}")


def pose_ahead(client: ArmClient, x: float = 0.0, gripper: float = 1.0) -> NDArray[np.float32]:
    """The action that moves the tool by ``x`` from where it is."""
    reading = client.status().reading
    assert reading is not None
    pose = pose_vector(reading.tcp_in_base, gripper)
    pose[0] += x
    return pose
