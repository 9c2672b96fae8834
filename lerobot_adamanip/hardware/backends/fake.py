"""An arm without mechanics, for tests of everything around it: it moves on a straight line and fails when told to.

No kinematics: the tool moves, the joints tell the rest posture. A wall stops the tool while its target goes on, which
is how a stall looks from the arm's process.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import (
    matrix_from_rotation_vector,
    pose_from_vector,
    rotation_vector_from_matrix,
    transform,
)
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, ArmTarget, Array
from lerobot_adamanip.hardware.arm_process.served import RESET, Served
from lerobot_adamanip.util import json_fields as checked_json
from lerobot_adamanip.util.errors import RobotError

START_ROTATION = np.array(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)))
"""Hand level, approach along +x."""
REST_QPOS = (0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8)
LEAN_STIFFNESS = 1000.0
"""Of the arm against a wall [N/m]: what the first joint's effort tells."""
FINGER_SPEED = 4.0
"""Of the opening [1/s]."""
NEAR = 1e-6


@dataclasses.dataclass(frozen=True)
class FakeOptions:
    """How the fake arm moves.

    Attributes:
        start: position of the tool at first [m, base frame].
        speed: of the tool [m/s]; its rotation takes as long as five times as many radians would.
        wall: the tool's x stays below this [m].
        stall_lag: of the tool behind its target that ends a key frame [m].
        time_limit: a key frame ends by then [s].
        period: of its ticks [s].
        log: file that gets a JSON line per tick and target, for tests that outlive their recorder; empty writes none.
    """

    start: tuple[float, float, float] = (0.5, 0.0, 0.4)
    speed: float = 0.2
    wall: float = 10.0
    stall_lag: float = 0.03
    time_limit: float = 30.0
    period: float = 0.02
    log: str = ""


class FakeBackend:
    """An `ArmBackend` of plain arithmetic. `inject` makes it fail in the ways a real arm does."""

    def __init__(self, options: FakeOptions) -> None:
        self._options = options
        self._tcp = transform(options.start, START_ROTATION)
        self._desired, self._goal = self._tcp.copy(), self._tcp.copy()
        self._gripper = self._gripper_goal = 1.0
        self._outcome: Outcome | None = None
        self._keyframe_ends: float | None = None
        self._time, self._frozen, self._lost, self._refuses = 0.0, False, False, 0
        self._flags: tuple[str, ...] = ()
        self._targets: list[list[float]] = []
        self._moving, self._stop_takes = False, 0.0
        self._log = open(options.log, "a", buffering=1, encoding="utf-8") if options.log else None  # noqa: SIM115

    @property
    def period(self) -> float:
        """Seconds between two ticks."""
        return self._options.period

    def connect(self) -> None:
        """Nothing to connect to."""

    def read(self) -> ArmReading:
        """Returns where the fake is. Raises `RobotError` once the loss of the connection was injected."""
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
        """Advances by one period, unless frozen or in a reflex."""
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
        step = float(np.clip(self._gripper_goal - self._gripper, -1.0, 1.0)) * FINGER_SPEED * self.period
        rest = self._gripper_goal - self._gripper
        self._gripper += step if abs(step) < abs(rest) and abs(rest) > 0.01 else rest
        self._moving = bool(np.abs(self._tcp - before).max() > NEAR)

    def _end_keyframe(self) -> None:
        if self._keyframe_ends is None:
            return
        lag = float(np.linalg.norm(self._desired[:3, 3] - self._tcp[:3, 3]))
        if lag > self._options.stall_lag:
            self._finish(Outcome.STALLED)
        elif np.abs(self._tcp - self._goal).max() < NEAR and self._gripper == self._gripper_goal:
            self._finish(Outcome.REACHED)
        elif self._time >= self._keyframe_ends:
            self._finish(Outcome.TIMEOUT)

    def _finish(self, outcome: Outcome) -> None:
        self._outcome, self._keyframe_ends = outcome, None
        self._goal = self._desired.copy()

    def stream(self, target: ArmTarget) -> None:
        """Replaces where the tool goes."""
        self._take(target)
        self._keyframe_ends = None

    def begin_keyframe(self, target: ArmTarget) -> None:
        """Begins a whole motion from where the tool is."""
        self._desired = self._tcp.copy()
        self._take(target)
        self._keyframe_ends = self._time + self._options.time_limit

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
        """Clears an injected reflex; raises `RobotError` as often as was injected."""
        if self._refuses:
            self._refuses -= 1
            raise RobotError("The fake arm does not recover.")
        self._flags = ()
        self.stop()

    def close(self) -> None:
        """Closes the log."""
        if self._log is not None:
            self._log.close()
            self._log = None

    # For tests -------------------------------------------------------------------------------------------------------

    def inject(self, values: dict[str, Any]) -> dict[str, Any]:
        """Makes the fake fail: ``kind`` is reflex (with ``flags``, ``refuses``), freeze, thaw, lost, hang or die."""
        fault = _FAULT("a fault", {"flags": [], "refuses": 0, "seconds": 0.0, **values})
        kind = fault["kind"]
        if kind == "reflex":
            self._flags, self._refuses = fault["flags"], fault["refuses"]
        elif kind in ("freeze", "thaw"):
            self._frozen = kind == "freeze"
            self._stop_takes = fault["seconds"] if self._frozen else 0.0
        elif kind == "lost":
            self._lost = True
        elif kind == "hang":
            time.sleep(fault["seconds"])
        else:
            os.kill(os.getpid(), signal.SIGKILL)
        return {}

    def reset(self, values: dict[str, Any]) -> dict[str, Any]:
        """Puts the tool where it began; tells the seed, as a twin's reset does."""
        seed = _RESET("a reset", {"seed": 0, **values})["seed"]
        self._tcp = transform(self._options.start, START_ROTATION)
        self._gripper = self._gripper_goal = 1.0
        self._outcome = None
        self.stop()
        return {"seed": seed}

    def targets(self, _: dict[str, Any]) -> dict[str, Any]:
        """Tells every target that was accepted."""
        return {"targets": self._targets}

    def _write(self, row: dict[str, Any]) -> None:
        if self._log is not None:
            self._log.write(json.dumps(row) + "\n")


def _towards(start: Array, goal: Array, step: float) -> Array:
    """Returns the pose on the way to ``goal`` after ``step`` [m], or five times as many radians."""
    turn = rotation_vector_from_matrix(start[:3, :3].T @ goal[:3, :3])
    way = max(float(np.linalg.norm(goal[:3, 3] - start[:3, 3])), float(np.linalg.norm(turn)) / 5)
    if way <= step:
        return goal.copy()
    share = step / way
    position = start[:3, 3] + share * (goal[:3, 3] - start[:3, 3])
    return transform(position, start[:3, :3] @ matrix_from_rotation_vector(share * turn))


_SECONDS = checked_json.number(0.0, 3600.0)
_METRES = checked_json.number(-10.0, 10.0)
_FAULT = checked_json.table(
    {
        "kind": checked_json.choice(("reflex", "freeze", "thaw", "lost", "hang", "die")),
        "seconds": _SECONDS,
        "flags": checked_json.listing(checked_json.text("[a-z_]{1,80}", "a flag"), 0, 41),
        "refuses": checked_json.integer(0, 100),
    }
)
_RESET = checked_json.table({"seed": checked_json.integer(0, 2**53)})
_OPTIONS = checked_json.table(
    {
        "start": checked_json.listing(_METRES, 3, 3),
        "speed": checked_json.number(1e-6, 10.0),
        "wall": _METRES,
        "stall_lag": checked_json.number(1e-6, 1.0),
        "time_limit": _SECONDS,
        "period": checked_json.number(1e-4, 1.0),
        "log": checked_json.text(r"[^\0]*", "a path"),
    }
)


def serve_fake(options: dict[str, Any]) -> Served:
    """Returns the fake with its requests. Raises ValueError for a wrong option."""
    found = FakeOptions(**_OPTIONS("the fake's options", {**dataclasses.asdict(FakeOptions()), **options}))
    if found.log and not Path(found.log).parent.is_dir():
        raise ValueError(f"no folder for the log {found.log!r}")
    backend = FakeBackend(found)
    return Served(backend, {"inject": backend.inject, RESET: backend.reset, "targets": backend.targets}, dict)
