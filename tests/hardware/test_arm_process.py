"""The arm process with a fake arm: targets, faults, lockstep, deaths of either process, and checks of targets."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_arm import LOCKSTEP, START_ROTATION, eventually, fake_arm, pose_ahead

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import pose_vector, rotation_about, transform
from lerobot_adamanip.hardware.arm import (
    ArmMode,
    ArmReading,
    ArmStatus,
    ArmTarget,
    Execution,
    ServerOptions,
)
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.arm_process.server import malformed
from lerobot_adamanip.hardware.safety import SafetyLimits
from lerobot_adamanip.util.errors import RobotError


@pytest.fixture
def arm() -> Iterator[ArmClient]:
    with fake_arm() as client:
        yield client


def read(status: ArmStatus) -> ArmReading:
    assert status.reading is not None
    return status.reading


def position(client: ArmClient) -> float:
    return float(read(client.status()).tcp_in_base[0, 3])


def play(client: ArmClient, x: float, gripper: float = 1.0) -> ArmReading:
    """Plays a key frame ``x`` ahead."""
    return read(client.wait(client.send(pose_ahead(client, x, gripper), Execution.KEYFRAME), 20))


def inject(client: ArmClient, kind: str, **values: Any) -> None:
    client.request("inject", {"kind": kind, **values})


def fault_of(client: ArmClient) -> str:
    fault = eventually(client, lambda status: status.fault is not None).fault
    assert fault is not None
    return fault


def test_a_key_frame_is_reached_and_a_wall_ends_it_in_a_stall() -> None:
    with fake_arm(wall=0.55) as arm:
        reached = play(arm, 0.03, gripper=0.0)
        assert (reached.outcome, reached.gripper) == (Outcome.REACHED, 0.0)
        assert reached.tcp_in_base[0, 3] == pytest.approx(0.53, abs=1e-6)
        stalled = play(arm, 0.2)
        assert stalled.outcome is Outcome.STALLED
        assert stalled.tcp_in_base[0, 3] == pytest.approx(0.55)
        assert stalled.effort[0] > 20  # it leans
        assert play(arm, -0.05).outcome is Outcome.REACHED


def test_the_newest_of_a_stream_wins_and_a_stream_that_ends_is_held() -> None:
    with fake_arm(speed=0.05) as arm:
        for x in (0.3, -0.3, 1.0):
            arm.send(pose_ahead(arm, x), Execution.STREAM)
        eventually(arm, lambda status: read(status).mode is ArmMode.MOVING)
        eventually(arm, lambda status: read(status).mode is ArmMode.IDLE)
        assert arm.request("targets")["targets"][-1][0] > 1.0
        stands = position(arm)
        assert 0.5 < stands < 0.6  # on its way, 1 m ahead, when commands stopped
        time.sleep(0.2)
        assert position(arm) == stands
        arm.send(pose_ahead(arm, 0.5), Execution.STREAM)
        eventually(arm, lambda status: position(arm) > stands)


def test_a_reflex_names_its_flags_and_nothing_is_accepted_until_recovery(arm: ArmClient) -> None:
    arm.send(pose_ahead(arm, 1.0), Execution.STREAM)
    eventually(arm, lambda status: status.accepted == 1)
    inject(arm, "reflex", flags=["cartesian_reflex", "joint_reflex"], refuses=1)
    with contextlib.suppress(RobotError):
        arm.send(pose_ahead(arm, 0.1), Execution.STREAM)  # by a recorder that has not seen the fault yet
    assert "reflex): cartesian_reflex, joint_reflex" in fault_of(arm)
    with pytest.raises(RobotError, match=r"(?s)joint_reflex.*recover"):
        arm.send(pose_ahead(arm, 0.1), Execution.STREAM)
    with pytest.raises(RobotError, match="does not recover"):
        arm.request("recover")
    stood = position(arm)
    arm.request("recover")
    time.sleep(0.1)
    arm.healthy()
    assert position(arm) == stood  # no target of before is executed
    assert len(arm.request("targets")["targets"]) == 1
    play(arm, 0.01)
    assert len(arm.request("targets")["targets"]) == 2


@pytest.mark.parametrize("stop_takes", [0.0, 3.0])
def test_a_clock_that_stands_still_is_a_fault_published_before_the_arm_is_stopped(stop_takes: float) -> None:
    with fake_arm(ServerOptions(state_age=1.0)) as arm:
        inject(arm, "freeze", seconds=stop_takes)
        began = time.perf_counter()
        assert "s old, more than 1 s" in fault_of(arm)  # a status older than 1 s would be an error
        assert time.perf_counter() - began > 0.9
        if not stop_takes:
            inject(arm, "thaw")
            arm.request("recover")
            arm.healthy()


def test_a_lost_connection_is_repaired_by_connecting_only(arm: ArmClient) -> None:
    inject(arm, "lost")
    eventually(arm, lambda status: status.lost)
    with pytest.raises(RobotError, match=r"(?s)lost.*connect again"):
        arm.healthy()
    with pytest.raises(RobotError, match="connect again"):
        arm.request("recover")
    arm.close()
    arm.connect()
    arm.healthy()


def test_a_target_that_no_filter_lets_through_is_a_fault(arm: ArmClient) -> None:
    pose = pose_ahead(arm, 0.1)
    pose[2] = np.nan
    arm.send(pose, Execution.STREAM)
    assert "no pose" in fault_of(arm)
    assert arm.request("targets") == {"targets": []}


def test_a_process_that_dies_is_noticed_named_and_replaced(arm: ArmClient) -> None:
    arm.post("inject", {"kind": "die"})
    with pytest.raises(RobotError, match="exit status -9"):
        eventually(arm, lambda _: False)
    with pytest.raises(RobotError, match="exit status -9"):
        arm.send(np.zeros(10, np.float32), Execution.STREAM)
    arm.close()
    arm.connect()
    assert arm.healthy().accepted == 0


def test_a_process_that_hangs_is_noticed_and_killed_within_two_seconds() -> None:
    for _ in range(3):  # a loaded machine may delay one
        arm = fake_arm(ServerOptions(state_age=0.5))
        arm.connect()
        arm.post("inject", {"kind": "hang", "seconds": 60.0})
        began = time.perf_counter()
        with pytest.raises(RobotError, match="publishes no state"):
            eventually(arm, lambda _: False)
        noticed = time.perf_counter()
        arm.close()
        closed = time.perf_counter()
        arm.close()
        if noticed - began < 1.5 and closed - noticed < 2.0:
            return
    pytest.fail(f"noticed after {noticed - began:.1f} s, closed {closed - noticed:.1f} s later")


@pytest.mark.parametrize("factory", ["no_such_module:serve", "fake_arm:no_such_function"])
def test_a_backend_that_is_none_is_no_hang(factory: str) -> None:
    with pytest.raises(RobotError, match="no_such"):
        ArmClient(factory, connect_time=60).connect()


def test_unknown_requests_are_refused(arm: ArmClient) -> None:
    with pytest.raises(RobotError, match="unknown request 'dance'; known are inject, reset"):
        arm.request("dance")
    with pytest.raises(RobotError, match="lockstep"):
        arm.request("step")


def test_in_lockstep_each_target_takes_its_share_of_time_and_nothing_else_does() -> None:
    with fake_arm(LOCKSTEP) as arm:
        goal = pose_ahead(arm, 1.0)
        for count in range(1, 31):
            arm.send(goal, Execution.STREAM)
            now = read(arm.status()).robot_time
            assert abs(now - count / 30) < 0.02  # less than a tick, and never growing
        assert now == pytest.approx(1.0)
        time.sleep(0.1)
        assert read(arm.status()).robot_time == now
        assert play(arm, -0.1).outcome is Outcome.REACHED


def test_in_lockstep_a_reset_is_seen_at_once_and_begins_time_anew() -> None:
    """Nothing ticks between a reset and the next observation; and steps before it leave no part of a tick behind."""
    with fake_arm(LOCKSTEP, speed=1.0) as arm:
        start = read(arm.status()).tcp_in_base
        for steps_before in (1, 2, 3):
            for _ in range(steps_before):
                arm.send(pose_ahead(arm, 0.2), Execution.STREAM)
            assert position(arm) > start[0, 3] + 0.01
            assert arm.request("reset", {"seed": 7}) == {"seed": 7}
            again = read(arm.status())
            np.testing.assert_array_equal(again.tcp_in_base, start)
            arm.send(pose_ahead(arm, 0.2), Execution.STREAM)
            passed = read(arm.status()).robot_time - again.robot_time
            assert passed == pytest.approx(0.02)  # one tick of the 33 ms, 13 are owed
            arm.request("reset", {"seed": 7})


def test_a_flood_of_requests_leaves_the_ticks_their_time(arm: ArmClient) -> None:
    before = read(arm.status()).robot_time
    until = time.perf_counter() + 0.5
    while time.perf_counter() < until:
        arm.post("targets")
        arm.healthy()
    assert read(arm.status()).robot_time > before + 0.2
    assert arm.request("targets") == {"targets": []}  # no request starves


RECORDER = """
import sys, time
sys.path.insert(0, {helpers!r})
from fake_arm import fake_arm, pose_ahead
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, Execution
arm = fake_arm(speed=0.05, log={log!r}, connect_takes={takes})
arm.connect()
goal = pose_ahead(arm, 1.0)
while True:
    arm.send(goal, Execution.STREAM)
    time.sleep(0.02)
"""


def rows_of(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text().splitlines()]


def kill_recorder(code: str, log: Path, until_logged: str, **named: Any) -> tuple[list[dict[str, Any]], float]:
    """Kills a recorder once its arm has logged something; returns the arm's log, and when the recorder was killed."""
    recorder = subprocess.Popen(
        [sys.executable, "-c", code.format(helpers=str(Path(__file__).parent), log=str(log), **named)]
    )
    end = time.perf_counter() + 30
    while not (log.exists() and any(row.get(until_logged) for row in rows_of(log))):
        assert time.perf_counter() < end
        time.sleep(0.05)
    recorder.kill()
    killed = time.perf_counter()
    recorder.wait()
    arm_process = Path(f"/proc/{rows_of(log)[0]['connecting']}")
    while arm_process.exists() and time.perf_counter() < killed + 10:
        time.sleep(0.02)
    assert not arm_process.exists()
    return rows_of(log), killed


def test_a_recorder_that_is_killed_leaves_an_arm_at_rest_and_no_process(tmp_path: Path) -> None:
    """Measured by the arm: it rests at once, and its process ends."""
    rows, killed = kill_recorder(RECORDER, tmp_path / "log", "moving", takes=0.0)
    target = [row for row in rows if "target" in row][-1]["target"]
    ticks = [row for row in rows if "tcp" in row]
    assert not ticks[-1]["moving"]
    assert [row for row in ticks if row["moving"] and row["time"] > killed + 0.5] == []
    assert ticks[-1]["tcp"][0] < target[0] - 0.5


def test_a_recorder_that_is_killed_while_its_arm_connects_leaves_no_process(tmp_path: Path) -> None:
    """A driver may hang in connect, where nothing looks at the recorder."""
    kill_recorder(RECORDER, tmp_path / "log", "connecting", takes=60.0)


def test_terminal_signals_do_not_reach_the_arm_before_its_recorder(arm: ArmClient) -> None:
    """A process group of its own; and by itself it ignores Ctrl-C, but ends in order when asked to terminate."""
    assert arm._process is not None
    pid = arm._process.pid
    assert os.getsid(pid) != os.getsid(0)
    os.kill(pid, signal.SIGINT)
    time.sleep(0.2)
    arm.healthy()
    os.kill(pid, signal.SIGTERM)
    assert arm._process.wait(10) == 0


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
        ((0.5, 0.0, 0.035), Execution.KEYFRAME, 0.0, None),
        ((0.5, 0.0, 0.035), Execution.KEYFRAME, np.pi / 2, "hand outside the box"),  # the tool is inside, a corner not
        ((0.5, 0.0, 0.03), Execution.KEYFRAME, 0.0, "hand outside the box"),
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
