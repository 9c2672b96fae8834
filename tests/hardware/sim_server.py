"""A simulated FR3 (franky-sim) as a process: writes down what it is commanded, and goes into a reflex when told to.

    python sim_server.py LOG [HOSTNAME]

Prints its address. A line on stdin, the number of a flag (libfranka's order; 7 is cartesian_reflex), is a reflex. LOG
gets JSON lines of four kinds: ``{"t", "c"}`` a commanded pose, ``{"t", "p"}`` a measured one (every 10 ms), ``{"t",
"move"}`` a motion that began and ``{"t", "recover"}``: what the arm's controller has seen, whatever programs believe.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from franky_sim import simulation_server
from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand,
    AutomaticErrorRecoveryStatus,
    BaseCommand,
    MoveStatus,
    RobotCommand,
    RobotMode,
)
from franky_sim.franka_robot_server import FrankaRobotServer
from franky_sim.mujoco_simulator import MujocoSimulator

REST = np.array((0.0, -0.3, 0.0, -2.2, 0.0, 1.9, 0.8))
FLAGS = 41


class FaultyServer(FrankaRobotServer):
    """Franky-sim's server with a memory, and with a controller that can stop itself."""

    log: TextIO
    asked: list[int]

    def __init__(self, robot: Any, hostnames: Iterable[str]) -> None:
        self.reflex: int | None = None
        self.ticks = 0
        super().__init__(robot, hostnames)

    def note(self, **row: object) -> None:
        self.log.write(json.dumps({"t": time.perf_counter(), **row}) + "\n")

    @property
    def robot_state(self) -> Any:
        state = super().robot_state
        if self.reflex is None:
            return state
        flags = tuple(place == self.reflex for place in range(FLAGS))
        return state.replace(errors=flags, reflex_reason=flags, robot_mode=RobotMode.kReflex)

    def start_motion(self, *args: Any, **options: Any) -> None:
        self.note(move=self.reflex is None)
        super().start_motion(*args, **options)

    def recovered(self) -> None:
        self.reflex = None
        self.note(recover=True)

    def _handle_udp_command(self, command_data: bytes) -> None:
        super()._handle_udp_command(command_data)
        command = self._FrankaRobotServer__current_control_command  # type: ignore[attr-defined]
        if any(command.O_T_EE_c):
            self.note(c=list(command.O_T_EE_c))

    def _pre_process_commands(self) -> None:
        super()._pre_process_commands()
        self.ticks += 1
        if self.ticks % 10 == 0:
            self.note(p=list(super().robot_state.O_T_EE))
        if self.asked and self.reflex is None:
            self.reflex, motion = self.asked.pop(0), self.current_motion_id
            self.note(reflex=self.reflex)
            self.stop_motion(send_preemption_signal=False)
            if motion:
                BaseCommand.send_response(self._tcp_socket, RobotCommand.kMove, motion, MoveStatus.kReflexAborted)
                self.reset_current_motion_id()


def recover(command: AutomaticErrorRecoveryCommand, server: FaultyServer) -> None:
    server.recovered()
    command.reply(AutomaticErrorRecoveryStatus.kSuccess)


def main(log: Path, hostnames: list[str]) -> None:
    simulation_server.FrankaRobotServer = FaultyServer
    AutomaticErrorRecoveryCommand.handle = recover
    FaultyServer.asked = []
    with open(log, "a", buffering=1, encoding="utf-8") as FaultyServer.log, MujocoSimulator() as simulator:
        arm = simulator.add_robot(initial_q=REST)
        candidates = hostnames or simulation_server.LocalHostnames()
        with simulation_server.SimulationServer(simulator, candidates) as server:
            print(arm.hostname, flush=True)
            threading.Thread(target=listen, daemon=True).start()
            server.run_forever()


def listen() -> None:
    for line in sys.stdin:
        FaultyServer.asked.append(int(line))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
