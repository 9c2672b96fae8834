"""The real arm's backend against a simulated FR3 that speaks Franka's protocol, judged by what that FR3 has seen."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sim_arm import BOX, HERE, SimulatedArm, robot_on

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.adamanip_franka.adamanip_franka import AdamanipFranka
from lerobot_adamanip.hardware.backends.franky_options import FrankyOptions
from lerobot_adamanip.hardware.safety import SafetyLimits
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_adamanip.util.errors import RobotError

pytestmark = [pytest.mark.franky, pytest.mark.nightly, pytest.mark.timeout(1200)]
"""At night, in an environment of its own (scripts/nightly.sh): what is judged by the clock wants the machine to itself,
and what the simulated FR3 brings would take the place of SAPIEN's kinematics."""

LIMIT = FrankyOptions.dynamics * 3.0
"""FR3's translation velocity at the default dynamics [m/s]."""


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[SimulatedArm]:
    simulated = SimulatedArm(tmp_path / "log")
    yield simulated
    simulated.kill()


@pytest.fixture
def make(arm: SimulatedArm, tmp_path: Path) -> Iterator[Callable[..., AdamanipFranka]]:
    robots: list[AdamanipFranka] = []

    def make(**options: Any) -> AdamanipFranka:
        robots.append(robot_on(arm, tmp_path, **options))
        return robots[-1]

    yield make
    for robot in robots:
        robot.disconnect()


def pose(robot: AdamanipFranka) -> np.ndarray:
    seen = robot.get_observation()
    return np.array([seen[name] for name in POSE_NAMES], np.float32)


def act(robot: AdamanipFranka, target: np.ndarray) -> np.ndarray:
    sent = robot.send_action(dict(zip(POSE_NAMES, target.tolist(), strict=True)))
    return np.array([sent[name] for name in POSE_NAMES], np.float32)


def outcome(robot: AdamanipFranka) -> Outcome:
    robot.get_observation()
    assert robot.session.reading is not None
    assert robot.session.reading.outcome is not None
    return robot.session.reading.outcome


def moved(start: np.ndarray, position: tuple[float, float, float] = (0, 0, 0), turn: float = 0.0) -> np.ndarray:
    tcp, gripper = pose_from_vector(start)
    tcp[:3, :3] = tcp[:3, :3] @ rotation_about((0.3, 0.5, 1.0), turn)
    return pose_vector(transform(tcp[:3, 3] + position, tcp[:3, :3]), gripper)


def stream_until(robot: AdamanipFranka, arm: SimulatedArm, target: np.ndarray, milliseconds: int) -> None:
    until = arm.now + milliseconds
    while arm.now < until:
        act(robot, target)
        time.sleep(0.03)


def act_until(robot: AdamanipFranka, target: np.ndarray, end: float) -> None:
    while time.perf_counter() < end:
        act(robot, target)
        time.sleep(0.02)


def test_connecting_moves_nothing(arm: SimulatedArm, make: Callable[..., AdamanipFranka]) -> None:
    robot = make()
    robot.connect()
    connected = arm.now
    arm.pass_time(2000)
    _, poses = arm.poses("p", connected)
    assert np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1).max() < 0.001


def goals(start: np.ndarray, count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    spread = np.array((0.06, 0.10, 0.06))
    return [moved(start, tuple(rng.uniform(-spread, spread)), rng.uniform(-0.3, 0.3)) for _ in range(count)]


def test_twenty_goals_are_reached(make: Callable[..., AdamanipFranka]) -> None:
    robot = make(execution="keyframe")
    robot.connect()
    for goal in goals(pose(robot), 20):
        sent = act(robot, goal)
        assert outcome(robot) is Outcome.REACHED
        off, turned = pose_error(pose_from_vector(pose(robot))[0], pose_from_vector(sent)[0])
        assert off < 0.003
        assert turned < 0.02


def speeds(milliseconds: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Of commanded poses [m/s], over 200 ms, so that a packet which comes a millisecond late is half a percent."""
    behind = 200
    moved_by = np.linalg.norm(poses[behind:, :3, 3] - poses[:-behind, :3, 3], axis=1)
    passed = np.maximum(milliseconds[behind:] - milliseconds[:-behind], behind) / 1000.0
    return np.asarray(moved_by / passed)


def test_what_is_out_of_the_box_or_too_fast_arrives_clipped(
    arm: SimulatedArm, make: Callable[..., AdamanipFranka]
) -> None:
    box = {**BOX, "box_lower": (0.2, -0.4, 0.3)}
    robot = make(execution="keyframe", **box)
    robot.connect()
    start = pose(robot)
    sent = act(robot, moved(start, (0.0, 0.0, -2.0)))
    limits = SafetyLimits(**box)
    assert limits.contains(pose_from_vector(sent)[0])
    assert outcome(robot) is Outcome.REACHED
    milliseconds, commanded = arm.poses("c")
    assert len(commanded) > 500
    assert all(limits.contains(each, 1e-4) for each in commanded)
    assert commanded[-1][2, 3] == pytest.approx(sent[2], abs=1e-4)
    fastest = speeds(milliseconds, commanded).max()
    assert 0.9 * LIMIT < fastest <= 1.01 * LIMIT


def test_a_stream_is_followed_no_faster_than_its_limit(arm: SimulatedArm, make: Callable[..., AdamanipFranka]) -> None:
    robot = make()
    robot.connect()
    goal = moved(pose(robot), (0.1, 0.0, 0.0))
    stream_until(robot, arm, goal, 2500)
    milliseconds, commanded = arm.poses("c")
    assert speeds(milliseconds, commanded).max() <= 1.01 * LIMIT
    # Planned anew again and again towards a target that rests, it went past that by half of what it takes to brake.
    assert commanded[:, 0, 3].max() <= goal[0] + 0.003
    assert commanded[-1][0, 3] == pytest.approx(goal[0], abs=0.001)


def run_into_a_reflex(robot: AdamanipFranka, arm: SimulatedArm) -> None:
    """In motion: it is named, and no motion begins after it."""
    start = pose(robot)
    stream_until(robot, arm, moved(start, (0.1, 0.0, 0.0)), 300)
    arm.reflex()
    with pytest.raises(RobotError, match="cartesian_reflex"):
        stream_until(robot, arm, moved(start, (0.1, 0.0, 0.0)), 10_000)
    for _ in range(3):
        with pytest.raises(RobotError, match="cartesian_reflex"):
            act(robot, start)
    (reflex,) = arm.rows("reflex")
    assert arm.rows("move", reflex["k"]) == []


def test_a_reflex_is_named_stops_everything_and_is_recovered_from(
    arm: SimulatedArm, make: Callable[..., AdamanipFranka]
) -> None:
    robot = make(execution="stream")
    robot.connect()
    run_into_a_reflex(robot, arm)
    here = arm.poses("p")[1][-1]
    robot.recover()
    assert len(arm.rows("recover")) == 1
    sent = act(robot, moved(pose(robot), (0.1, 0.0, 0.0)))
    assert np.linalg.norm(sent[:3] - here[:3, 3]) < 0.003  # the first target is where the arm is
    stream_until(robot, arm, moved(pose(robot), (0.05, 0.0, 0.0)), 300)


def test_the_gripper_is_commanded_on_change_and_opens_as_told(
    arm: SimulatedArm, make: Callable[..., AdamanipFranka]
) -> None:
    robot = make(execution="keyframe")
    robot.connect()
    start = pose(robot)
    for opening in (1.0, 1.0, 0.9, 0.0, 0.2, 1.0):
        start[9] = opening
        act(robot, start)
    told = pose(robot)[9] * 0.08
    assert told == pytest.approx(arm.rows("p")[-1]["width"], abs=0.001)
    assert told > 0.075


def ticks(robot: AdamanipFranka, openings: list[float]) -> np.ndarray:
    """Of a stream at 30 Hz: how long each takes [s]."""
    goal, took, due = pose(robot), [], time.perf_counter()
    for opening in openings:
        goal[9] = opening
        began = time.perf_counter()
        act(robot, goal)
        robot.get_observation()
        took.append(time.perf_counter() - began)
        due += 1 / 30
        time.sleep(max(0.0, due - time.perf_counter()))
    return np.array(took)


def test_a_hand_that_moves_delays_no_tick(arm: SimulatedArm, make: Callable[..., AdamanipFranka]) -> None:
    """A tick that waited for the hand, which takes half a second, would add 17 ms to the mean."""
    robot = make()
    robot.connect()
    still = ticks(robot, [1.0] * 270)
    moving = ticks(robot, [float(tick // 30 % 2) for tick in range(270)])
    widths = np.array([row["width"] for row in arm.rows("p")])
    assert np.ptp(widths) > 0.05
    assert moving.mean() - still.mean() < 0.005


@pytest.mark.parametrize("death", ["kill", "freeze"])
def test_a_controller_that_dies_or_freezes_is_one_clear_error(
    arm: SimulatedArm, make: Callable[..., AdamanipFranka], tmp_path: Path, death: str
) -> None:
    robot = make(state_age=0.6)  # below libfranka's own second
    robot.connect()
    goal = moved(pose(robot), (0.1, 0.0, 0.0))
    stream_until(robot, arm, goal, 200)
    getattr(arm, death)()
    died = time.perf_counter()
    with pytest.raises(RobotError, match=r"lost|s old|no state|gripper failed"):
        act_until(robot, goal, died + 20)
    assert time.perf_counter() - died < 1.5
    began = time.perf_counter()
    robot.disconnect()
    assert time.perf_counter() - began < 2.0
    arm.kill()
    again = SimulatedArm(tmp_path / "again", arm.host)
    try:
        robot.connect()
        robot.get_observation()
        robot.disconnect()
    finally:
        again.kill()


RECORDER = """
import sys, time
from pathlib import Path
sys.path.insert(0, {helpers!r})
from types import SimpleNamespace
from sim_arm import robot_on
from test_franky_sim import act, moved, pose
robot = robot_on(SimpleNamespace(host={host!r}), Path({folder!r}))
robot.connect()
start = pose(robot)
print("connected", flush=True)
while True:
    sent = act(robot, moved(start, (0.1, 0.0, 0.0)))
    print(sent[0], flush=True)
    time.sleep(0.03)
"""


def test_a_recorder_that_is_killed_leaves_the_arm_at_rest_before_its_last_target(
    arm: SimulatedArm, tmp_path: Path
) -> None:
    code = RECORDER.format(helpers=str(HERE), host=arm.host, folder=str(tmp_path))
    recorder = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert recorder.stdout is not None
    assert recorder.stdout.readline() == "connected\n"
    start = arm.poses("p")[1][-1][0, 3]
    arm.pass_time(10)
    while arm.poses("p")[1][-1][0, 3] < start + 0.01:
        time.sleep(0.05)
    recorder.kill()
    killed = arm.now
    last = [float(line) for line in recorder.stdout.read().splitlines()][-1]
    recorder.wait()
    arm.pass_time(1500)
    milliseconds, poses = arm.poses("p", killed)
    position = poses[:, 0, 3]
    assert position.max() <= last + 0.001
    at_rest = milliseconds >= killed + 800  # at the default dynamics, the last target is 4 cm ahead
    assert np.ptp(position[at_rest]) < 0.001
