"""A simulated FR3 for tests: its process, what it has seen, and robots that drive it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.hardware.adamanip_franka.adamanip_franka import AdamanipFranka
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig

BOX = {"box_lower": (0.2, -0.4, 0.0), "box_upper": (0.75, 0.4, 0.75)}
HERE = Path(__file__).parent


class SimulatedArm:
    """A process of `sim_server.py`. Time is the simulation's: a busy machine makes it slower, not wrong."""

    def __init__(self, log: Path, hostname: str = "") -> None:
        self.log = log
        command = [sys.executable, str(HERE / "sim_server.py"), str(log), *([hostname] if hostname else [])]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.host = self.process.stdout.readline().strip()
        assert self.host, "franky-sim did not start"

    def rows(self, kind: str, since: int = 0) -> list[dict[str, Any]]:
        """What it wrote down of one kind, from a simulated millisecond on."""
        text = self.log.read_text(encoding="utf-8").rpartition("\n")[0]
        every = (json.loads(line) for line in text.splitlines())
        return [row for row in every if kind in row and row["k"] >= since]

    def poses(self, kind: str, since: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """(simulated ms (N,), poses (N, 4, 4)) that were measured ("p") or commanded ("c")."""
        rows = self.rows(kind, since)
        poses = np.array([row[kind] for row in rows]).reshape(-1, 4, 4).transpose(0, 2, 1)
        return np.array([row["k"] for row in rows]), poses

    @property
    def now(self) -> int:
        """Simulated ms."""
        rows = self.rows("p")
        return int(rows[-1]["k"]) if rows else 0

    def pass_time(self, milliseconds: int, limit: float = 280.0) -> None:
        """Waits until so much time has passed in the simulation."""
        until, end = self.now + milliseconds, time.perf_counter() + limit
        while self.now < until:
            assert time.perf_counter() < end, "the simulation stands still"
            time.sleep(0.05)

    def reflex(self, flag: int = 7) -> None:
        """The arm stops itself; 7 is cartesian_reflex."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{flag}\n")
        self.process.stdin.flush()

    def freeze(self) -> None:
        os.kill(self.process.pid, signal.SIGSTOP)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


def robot_on(arm: SimulatedArm, folder: Path, **options: Any) -> AdamanipFranka:
    """The robot as configured for a simulated FR3: watchdogs of wall time are wide, a busy machine slows the arm."""
    given = {"state_age": 20.0, "command_age": 20.0, "motion_time": 250.0, "action": "ee_pose", **BOX, **options}
    config = AdamanipFrankaConfig(
        id="sim", calibration_dir=folder, address=arm.host, model="fr3", realtime=False, **given
    )
    return AdamanipFranka(config)
