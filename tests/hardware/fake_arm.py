"""An arm without mechanics: the tool moves on a straight line, a wall stops it, and it fails when told to."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, transform
from lerobot_adamanip.hardware.arm import RESET, ArmMode, ArmReading, ArmStatus, ArmTarget, Array, Served, ServerOptions
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox, message
from lerobot_adamanip.util.errors import RobotError

START_ROTATION = np.array(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)))
REST_QPOS = (0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8)
LEAN_STIFFNESS, NEAR = 1000.0, 1e-6
STALL_LAG, TIME_LIMIT = 0.03, 30.0


@message
@dataclasses.dataclass(frozen=True)
class FakeOptions:
    """``log`` gets a JSON line for each tick and target, for tests that outlive their recorder."""

    start: tuple[float, float, float] = (0.5, 0.0, 0.4)
    speed: float = 0.2
    wall: float = 10.0
    log: str = ""
    connect_takes: float = 0.0
    flags: tuple[str, ...] = ()


class FakeBackend:
    period = 0.02

    def __init__(self, options: FakeOptions) -> None:
        self._options = options
        self._tcp = transform(options.start, START_ROTATION)
        self._desired, self._goal = self._tcp.copy(), self._tcp.copy()
        self._gripper = self._gripper_goal = 1.0
        self._outcome: Outcome | None = None
        self._keyframe_ends: float | None = None
        self._time, self._frozen, self._lost, self._refuses = 0.0, False, False, 0
        self._flags = options.flags
        self._targets: list[list[float]] = []
        self._moving, self._stop_takes = False, 0.0
        self._log = open(options.log, "a", buffering=1, encoding="utf-8") if options.log else None  # noqa: SIM115

    def connect(self) -> None:
        self._write({"connecting": os.getpid()})
        time.sleep(self._options.connect_takes)

    def read(self) -> ArmReading:
        if self._lost:
            raise RobotError("The connection to the fake arm is lost.")
        lean = float(np.linalg.norm(self._desired[:3, 3] - self._tcp[:3, 3])) * LEAN_STIFFNESS
        moving = ArmMode.MOVING if self._moving else ArmMode.IDLE
        return ArmReading(
            stamp=time.perf_counter(),
            robot_time=self._time,
            tcp_in_base=self._tcp.copy(),
            gripper=self._gripper,
            qpos=np.array(REST_QPOS),
            qvel=np.full(7, 0.1 if self._moving else 0.0),
            effort=np.array([lean, *[0.0] * 6]),
            mode=ArmMode.REFLEX if self._flags else moving,
            errors=self._flags,
            outcome=self._outcome,
        )

    def tick(self) -> None:
        if self._frozen:
            return
        self._time += self.period
        if not self._flags:
            self._advance()
            self._end_keyframe()
        self._write({"time": time.perf_counter(), "tcp": self._tcp[:3, 3].tolist(), "moving": self._moving})

    def _advance(self) -> None:
        self._desired = _towards(self._desired, self._goal, self._options.speed * self.period)
        before, self._tcp = self._tcp, self._desired.copy()
        self._tcp[0, 3] = min(self._tcp[0, 3], self._options.wall)
        self._gripper = self._gripper_goal
        self._moving = bool(np.abs(self._tcp - before).max() > NEAR)

    def _end_keyframe(self) -> None:
        if self._keyframe_ends is None:
            return
        lag = float(np.linalg.norm(self._desired[:3, 3] - self._tcp[:3, 3]))
        if lag > STALL_LAG:
            self._finish(Outcome.STALLED)
        elif np.abs(self._tcp - self._goal).max() < NEAR:
            self._finish(Outcome.REACHED)
        elif self._time >= self._keyframe_ends:
            self._finish(Outcome.TIMEOUT)

    def _finish(self, outcome: Outcome) -> None:
        self._outcome, self._keyframe_ends = outcome, None
        self._goal = self._desired.copy()

    def stream(self, target: ArmTarget) -> None:
        self._take(target)
        self._keyframe_ends = None

    def begin_keyframe(self, target: ArmTarget) -> None:
        self._desired = self._tcp.copy()
        self._take(target)
        self._keyframe_ends = self._time + TIME_LIMIT

    def _take(self, target: ArmTarget) -> None:
        self._goal, self._gripper_goal = pose_from_vector(target.pose)
        self._outcome = None
        self._targets.append([float(value) for value in target.pose])
        self._write({"time": time.perf_counter(), "target": self._targets[-1]})

    def stop(self) -> None:
        """Stands still at once; frozen, it answers as late as was injected."""
        time.sleep(self._stop_takes)
        self._goal = self._desired = self._tcp.copy()
        self._keyframe_ends, self._moving = None, False

    def recover(self) -> None:
        if self._refuses:
            self._refuses -= 1
            raise RobotError("The fake arm does not recover.")
        self._flags = ()
        self.stop()

    def close(self) -> None:
        if self._log is not None:
            self._log.close()
            self._log = None

    def inject(self, fault: dict[str, Any]) -> dict[str, Any]:
        """``kind`` is reflex (with ``flags``, ``refuses``), freeze, thaw, lost, hang or die."""
        kind, seconds = fault["kind"], fault.get("seconds", 0.0)
        if kind == "reflex":
            self._flags, self._refuses = tuple(fault["flags"]), fault.get("refuses", 0)
        elif kind in ("freeze", "thaw"):
            self._frozen = kind == "freeze"
            self._stop_takes = seconds if self._frozen else 0.0
        elif kind == "lost":
            self._lost = True
        elif kind == "hang":
            time.sleep(seconds)
        else:
            os.kill(os.getpid(), signal.SIGKILL)
        return {}

    def reset(self, values: dict[str, Any]) -> dict[str, Any]:
        self._tcp = transform(self._options.start, START_ROTATION)
        self._gripper = self._gripper_goal = 1.0
        self._outcome = None
        self.stop()
        return {"seed": values["seed"]}

    def targets(self, _: dict[str, Any]) -> dict[str, Any]:
        """Every target that was accepted."""
        return {"targets": self._targets}

    def _write(self, row: dict[str, Any]) -> None:
        if self._log is not None:
            self._log.write(json.dumps(row) + "\n")


def _towards(start: Array, goal: Array, step: float) -> Array:
    """The pose ``step`` [m] on the way to ``goal``, turned already."""
    pose, way = goal.copy(), goal[:3, 3] - start[:3, 3]
    pose[:3, 3] = start[:3, 3] + way * min(1.0, step / max(float(np.linalg.norm(way)), NEAR))
    return pose


def serve_fake(options: FakeOptions, _: Mapping[str, Mailbox]) -> Served:
    backend = FakeBackend(options)

    def describe() -> dict[str, Any]:
        """Gets Ctrl-C at the earliest moment at which a recorder may send it."""
        os.kill(os.getpid(), signal.SIGINT)
        return {}

    return Served(backend, {"inject": backend.inject, RESET: backend.reset, "targets": backend.targets}, describe)


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
