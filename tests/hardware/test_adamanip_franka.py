"""The robot as LeRobot uses it, on the fake arm: features, filter, key frames, streams, faults, closing."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import draccus
import numpy as np
import pytest
from fake_arm import LOCKSTEP, PATIENT, eventually, fake_arm
from filter_fuzz import LIMITS, START
from lerobot.robots import RobotConfig
from lerobot.robots.utils import make_robot_from_config

from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, EE_POSE, FULL, POSE, STATES
from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import Array, pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.hardware.adamanip_franka import adamanip_franka
from lerobot_adamanip.hardware.adamanip_franka.adamanip_franka import AdamanipFranka, MotionDriver
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading, Execution, Served, ServerOptions
from lerobot_adamanip.hardware.arm_process import server
from lerobot_adamanip.hardware.arm_process.client import ArmClient
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics, save_calibration
from lerobot_adamanip.hardware.dense_kinds import encode_action
from lerobot_adamanip.hardware.features import ARM, ARM_NAMES, SENT_NAMES
from lerobot_adamanip.hardware.robot_registry import ROBOTS, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter
from lerobot_adamanip.hardware.teleoperators.config_devices import AdamanipKeyboardConfig
from lerobot_adamanip.hardware.teleoperators.devices import AdamanipKeyboard
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, RobotError
from lerobot_env_adamanip.twin.config_devices import AdamanipFrankaSimConfig
from lerobot_env_adamanip.twin.franka_sim import AdamanipFrankaSim

BOX = {"box_lower": (0.2, -0.5, 0.0), "box_upper": (0.9, 0.5, 0.8)}


@dataclass
class Command:
    """As LeRobot's commands have it."""

    robot: RobotConfig


class FakeFranka(AdamanipFranka):
    """The robot on the fake: what the twin does, too, is to say which process is started."""

    server: ServerOptions
    options: dict[str, Any]

    def _make_client(self) -> ArmClient:
        return fake_arm(self.server, **self.options)


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Callable[..., FakeFranka]]:
    robots: list[FakeFranka] = []

    def make(
        server: ServerOptions = PATIENT, wall: float = 0.7, flags: tuple[str, ...] = (), **options: Any
    ) -> FakeFranka:
        options = {**BOX, "action": EE_POSE, "state": FULL, **options}
        config = AdamanipFrankaConfig(id="test", calibration_dir=tmp_path, **options)
        robot = FakeFranka(config)
        robot.server, robot.options = server, {"wall": wall, "flags": flags}
        robots.append(robot)
        return robot

    yield make
    for robot in robots:
        robot.disconnect()


def arm_of(robot: FakeFranka) -> ArmClient:
    assert robot._client is not None
    return robot._client


def pose_of(observation: dict[str, Any]) -> dict[str, float]:
    return {name: observation[name] for name in POSE_NAMES}


def recorded(robot: FakeFranka, seen: dict[str, Any]) -> dict[str, float]:
    """The arm's reading that the recorder stores beside an observation."""
    state = np.array([seen[name] for name in robot.observation_features], np.float32)
    return dict(zip(ARM_NAMES, robot.session.rows.find(state)[ARM].tolist(), strict=True))


def test_lerobot_makes_it_from_its_own_command_line() -> None:
    arguments = ["--type=adamanip_franka", "--id=a", "--address=172.16.0.2", "--model=fr3"]
    box = ["--box_lower=[0.3, -0.4, 0.0]", "--box_upper=[0.8, 0.4, 0.7]"]
    given = [argument.replace("--", "--robot.", 1) for argument in [*arguments, *box]]
    robot = make_robot_from_config(draccus.parse(Command, None, args=given).robot)
    assert type(robot) is AdamanipFranka
    assert robot._safety_limits().box_lower == (0.3, -0.4, 0.0)
    assert robot.config.dynamics == 0.03
    assert not robot.is_connected


@pytest.mark.parametrize("action", [EE_DELTA, EE_POSE])
@pytest.mark.parametrize("state", [POSE, FULL])
def test_features_are_those_of_demonstrations(make: Callable[..., FakeFranka], action: str, state: str) -> None:
    robot = make(action=action, state=state)
    assert robot.observation_features == dict.fromkeys(STATES[state], float)
    assert robot.action_features == dict.fromkeys(ACTION_NAMES[action], float)
    names = (*robot.observation_features, *robot.action_features)
    assert all(name.endswith((".pos", ".vel")) for name in names)  # rollouts drop the others
    robot.connect()
    seen = robot.get_observation()
    assert set(seen) == {*STATES[state], *POSE_NAMES}  # and the pose, to which a rollout returns
    assert all(isinstance(value, float) for value in seen.values())
    row = recorded(robot, seen)
    assert row["arm.outcome"] == -1
    assert [row[name] for name in SENT_NAMES] == pytest.approx([seen[name] for name in POSE_NAMES], abs=1e-6)


@pytest.mark.parametrize("action", [EE_DELTA, EE_POSE])
def test_an_action_of_either_kind_moves_to_the_same_target(make: Callable[..., FakeFranka], action: str) -> None:
    robot = make(LOCKSTEP, action=action)
    robot.connect()
    robot.get_observation()
    for _ in range(12):
        reading = robot.session.reading
        assert reading is not None
        goal = reading.tcp_in_base.copy()
        goal[:3, 3] += (0.0, 0.002, 0.0)
        returned = robot.send_action(encode_action(action, pose_vector(goal, 0.5), reading))
        assert tuple(returned) == ACTION_NAMES[action]
        assert robot.session.sent is not None
        assert robot.session.sent[9] == pytest.approx(0.5)
        robot.get_observation()
    assert robot.session.reading is not None
    assert robot.session.reading.tcp_in_base[1, 3] > 0.015


def test_joint_positions_and_kinds_of_key_frames_are_refused(make: Callable[..., FakeFranka]) -> None:
    with pytest.raises(ConfigurationError, match="joint positions"):
        make(action="joint")
    for options in ({"action": EE_DELTA}, {"state": POSE}):
        with pytest.raises(ConfigurationError, match=r"(?s)does not fit.*execution=keyframe"):
            make(**{"execution": "keyframe", "action": None, "state": None, **options})
    with pytest.raises(AdaManipError, match="ee_delta"):
        make(action="ee_deltas")


def test_box_and_arm_have_to_be_given(make: Callable[..., FakeFranka], tmp_path: Path) -> None:
    for options, message in (({"box_lower": None}, "box that the hand"), ({"box_upper": (0.3, 0.5, 0.8)}, "too small")):
        with pytest.raises(ConfigurationError, match=message):
            make(**options).connect()
    with pytest.raises(ConfigurationError, match="which arm"):
        AdamanipFranka(AdamanipFrankaConfig(calibration_dir=tmp_path, **BOX)).connect()  # type: ignore[arg-type]
    with pytest.raises(AdaManipError, match="execution"):
        AdamanipFrankaConfig(execution="fast")
    with pytest.raises(AdaManipError, match="fr3, panda"):
        AdamanipFrankaConfig(model="fer")


def test_a_hand_outside_the_box_is_refused_and_nothing_is_left_running(make: Callable[..., FakeFranka]) -> None:
    robot = make(box_lower=(0.56, -0.5, 0.0))
    with pytest.raises(RobotError, match="outside the box"):
        robot.connect()
    assert not robot.is_connected
    assert ROBOTS.find("test") is None


def test_the_first_action_of_a_stream_does_not_move_it_the_next_only_so_far(
    make: Callable[..., FakeFranka],
) -> None:
    robot = make()
    robot.connect()
    start = pose_of(robot.get_observation())
    far = {**start, "ee.x.pos": start["ee.x.pos"] + 0.2}
    assert robot.send_action(far) == pytest.approx(start, abs=1e-6)
    time.sleep(0.03)
    sent = robot.send_action(far)
    assert 0.002 < sent["ee.x.pos"] - start["ee.x.pos"] <= 0.0101  # 0.1 m/s, at most 0.1 s
    row = recorded(robot, robot.get_observation())
    assert row["sent.ee.x"] == pytest.approx(sent["ee.x.pos"], abs=0)


def test_what_is_returned_is_what_the_arm_was_sent(make: Callable[..., FakeFranka]) -> None:
    robot = make(LOCKSTEP)
    robot.connect()
    start = pose_of(robot.get_observation())
    returned = [robot.send_action({**start, "ee.y.pos": 5.0}) for _ in range(40)]
    targets = arm_of(robot).request("targets")["targets"]
    assert [list(sent.values()) for sent in returned] == targets
    steps = np.diff([sent["ee.y.pos"] for sent in returned])
    assert steps.max() <= 0.1 / 30
    assert returned[-1]["ee.y.pos"] == pytest.approx(39 * 0.1 / 30, abs=1e-3)
    assert robot.session.details["lockstep_dt"] == 1 / 30


def test_a_key_frame_is_one_call_and_its_end_is_observed(make: Callable[..., FakeFranka]) -> None:
    robot = make(execution="keyframe")
    robot.connect()
    start = pose_of(robot.get_observation())
    sent = robot.send_action({**start, "ee.x.pos": 0.55, "gripper.pos": 0.0})
    seen = robot.get_observation()
    assert sent["ee.x.pos"] == pytest.approx(0.55)
    assert seen["ee.x.pos"] == pytest.approx(0.55, abs=1e-6)
    assert seen["gripper.pos"] == 0.0
    assert recorded(robot, seen)["arm.outcome"] == Outcome.REACHED
    robot.send_action({**start, "ee.x.pos": 0.8})  # a wall at 0.7
    assert recorded(robot, robot.get_observation())["arm.outcome"] == Outcome.STALLED


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("action", [EE_DELTA, EE_POSE])
def test_a_malformed_action_keeps_the_last_and_a_missing_name_is_an_error(
    make: Callable[..., FakeFranka], action: str, wrong: float
) -> None:
    robot = make(LOCKSTEP, action=action)
    robot.connect()
    start = pose_of(robot.get_observation())
    last = robot.send_action(start)
    stays = last if action == EE_DELTA else start
    for name in ACTION_NAMES[action]:
        assert robot.send_action({**stays, name: wrong}) == pytest.approx(last, abs=1e-5)
        assert robot.send_action(stays) == pytest.approx(last, abs=1e-5)  # which forgives the malformed one
    with pytest.raises(ConfigurationError, match=f"no {ACTION_NAMES[action][-1]}"):
        robot.send_action(dict.fromkeys(ACTION_NAMES[action][:-1], 0.0))


def inject_reflex(robot: FakeFranka) -> None:
    arm_of(robot).request("inject", {"kind": "reflex", "flags": ["cartesian_reflex"]})
    eventually(arm_of(robot), lambda status: status.fault is not None)


def test_a_reflex_is_raised_with_its_flags_and_recovered_by_hand(make: Callable[..., FakeFranka]) -> None:
    robot = make()
    robot.connect()
    start = pose_of(robot.get_observation())
    inject_reflex(robot)
    for call in (robot.get_observation, lambda: robot.send_action(start)):
        with pytest.raises(RobotError, match="cartesian_reflex"):
            call()
    robot.recover()
    robot.get_observation()
    assert robot.send_action({**start, "ee.x.pos": 0.6}) == pytest.approx(start, abs=1e-6)  # begins where it is


def test_a_recovery_leaves_the_gripper_as_commanded(driver: MotionDriver, arm: Arm, session: RobotSession) -> None:
    driver.send(pose_vector(START, 0.0), reading(arm.at, None))
    driver.recover()  # the fingers hold a wide part
    assert session.sent is not None
    assert session.sent[9] == 0.0
    driver.anchor()  # of a scene that was reset
    assert session.sent[9] == 1.0


def test_a_reflex_of_an_earlier_command_is_cleared_on_connecting_only_if_asked(make: Callable[..., FakeFranka]) -> None:
    left = ("joint_reflex",)
    with pytest.raises(RobotError, match=r"(?s)joint_reflex.*recover_on_connect=true"):
        make(flags=left).connect()
    robot = make(flags=left, recover_on_connect=True)
    robot.connect()
    start = pose_of(robot.get_observation())
    assert robot.send_action({**start, "ee.x.pos": 0.6}) == pytest.approx(start, abs=1e-6)


def test_a_lead_that_pulls_as_hard_as_the_reflex_is_refused(tmp_path: Path) -> None:
    options = {"address": "172.16.0.2", "model": "fr3", "calibration_dir": tmp_path, **BOX}
    with pytest.raises(ConfigurationError, match=r"(?s)0.06 m x stiffness 1000 N/m = 60 N.*below collision_force"):
        AdamanipFranka(AdamanipFrankaConfig(lead=0.06, **options)).connect()


def test_nothing_is_answered_before_connecting_or_after_disconnecting(make: Callable[..., FakeFranka]) -> None:
    robot = make()
    robot.disconnect()
    for call in (robot.get_observation, robot.recover, lambda: robot.send_action(dict.fromkeys(POSE_NAMES, 0.0))):
        with pytest.raises(RobotError, match="not connected"):
            call()
    robot.connect()
    with pytest.raises(RobotError, match="connected already"):
        robot.connect()
    assert ROBOTS.find("test") is robot.session
    robot.disconnect()
    assert ROBOTS.find("test") is None


def test_lerobots_warning_of_a_slow_loop_is_not_told_in_lockstep(
    make: Callable[..., FakeFranka], caplog: pytest.LogCaptureFixture
) -> None:
    robot = make(LOCKSTEP)
    robot.connect()
    for loop in ("Record", "Control"):
        logging.warning(f"{loop} loop is running slower (18.0 Hz) than the target FPS (30 Hz).")
    logging.warning("another")
    robot.disconnect()
    logging.warning("Record loop is running slower")
    assert caplog.messages == ["another", "Record loop is running slower"]


def test_a_file_of_cameras_does_not_pass_for_calibrations_of_motors(
    make: Callable[..., FakeFranka], tmp_path: Path
) -> None:
    """LeRobot reads `<id>.json` as those when it makes a robot, and fails."""
    robot = make()
    assert robot.calibration_file == tmp_path / "test.cameras.json"
    assert robot.calibration_file != robot.calibration_fpath
    assert robot.is_calibrated  # no camera with depth


@pytest.mark.parametrize(("width", "problem"), [(None, "test.cameras.json"), (16, "8 x 8, calibrated 16 x 8"), (8, "")])
def test_connecting_warns_once_of_depth_without_a_calibration_that_fits(
    make: Callable[..., FakeFranka],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    width: int | None,
    problem: str,
) -> None:
    monkeypatch.setattr(adamanip_franka, "check_cameras", lambda *_, **__: None)
    robot = make(depth=True)
    robot.cameras = {"front": Resource("front")}  # type: ignore[misc]
    robot.cameras["front"].use_depth = True  # type: ignore[attr-defined]
    if width is not None:
        imager = Intrinsics(np.eye(3), np.zeros(0), width, 8)
        save_calibration(robot.calibration_file, "front", CameraCalibration("front", imager, np.eye(4)))
    for calibrate in (False, True):
        robot.connect(calibrate=calibrate)
        robot.disconnect()
        warnings = [text for text in caplog.messages if "without a calibration that fits" in text]
        assert len(warnings) == int(calibrate and problem != "")
    assert problem in "".join(warnings)


class Arm:
    """Is at once where it is sent."""

    def __init__(self, at: Array) -> None:
        self.at, self.outcomes = at, [Outcome.REACHED] * 9
        self.sent: list[tuple[Execution, np.ndarray]] = []

    def send(self, pose: np.ndarray, execution: Execution) -> int:
        self.sent.append((execution, pose))
        return len(self.sent)

    def wait(self, number: int, time_limit: float) -> Any:
        outcome = self.outcomes.pop(0)
        if outcome is Outcome.REACHED:
            self.at = pose_from_vector(self.sent[number - 1][1])[0]
        return SimpleNamespace(reading=reading(self.at, outcome))

    def healthy(self) -> Any:
        return SimpleNamespace(reading=reading(self.at, None))

    def request(self, ask: str) -> None:
        assert ask == "recover"


def reading(at: Array, outcome: Outcome | None) -> ArmReading:
    seven = np.zeros(7)
    return ArmReading(0.0, 0.0, at, 1.0, seven, seven, seven, ArmMode.IDLE, outcome=outcome)


@pytest.fixture
def arm() -> Arm:
    return Arm(START)


@pytest.fixture
def session() -> RobotSession:
    return RobotSession()


@pytest.fixture
def driver(arm: Arm, session: RobotSession) -> MotionDriver:
    driver = MotionDriver(arm, session, SafetyFilter(LIMITS), Execution.KEYFRAME, 60.0)  # type: ignore[arg-type]
    driver.anchor()
    return driver


def floor(turn: float, gripper: float = 1.0) -> np.ndarray:
    position = (0.5, 0.0, LIMITS.box_lower[2])
    return pose_vector(transform(position, START[:3, :3] @ rotation_about((0, 0, 1), turn)), gripper)


def test_a_key_frame_that_turns_at_the_floor_is_sent_in_three_motions(
    driver: MotionDriver, arm: Arm, session: RobotSession
) -> None:
    driver.send(floor(0.0), reading(arm.at, None))
    sent = driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 4
    assert sent.tobytes() == arm.sent[-1][1].tobytes()
    assert session.sent is not None
    assert session.sent.tobytes() == sent.tobytes()
    driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 4  # the same again is no motion


def test_a_detour_that_is_blocked_ends_the_key_frame(driver: MotionDriver, arm: Arm, session: RobotSession) -> None:
    driver.send(floor(0.0), reading(arm.at, None))
    arm.outcomes = [Outcome.STALLED]
    sent = driver.send(floor(np.pi / 2), reading(arm.at, None))
    assert len(arm.sent) == 2
    assert sent.tobytes() == arm.sent[-1][1].tobytes()
    assert session.reading is not None
    assert session.reading.outcome is Outcome.STALLED


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_a_closed_hand_stays_closed_on_all_ways_but_to_an_open_goal(driver: MotionDriver, arm: Arm, end: float) -> None:
    """The first goal is blocked on its way, and the arm is then pushed farther than the lead."""
    driver.send(floor(0.0, 0.0), reading(arm.at, None))
    arm.outcomes[0] = Outcome.STALLED
    driver.send(floor(np.pi / 2, end), reading(arm.at, None))
    arm.at = transform(arm.at[:3, 3] + (0.0, 0.2, 0.0), arm.at[:3, :3])
    driver.send(floor(np.pi / 3, 1.0), reading(arm.at, None))
    assert [float(pose[9]) for _, pose in arm.sent] == [0.0, 0.0, 0.0, 0.0, 1.0]


def test_a_malformed_action_after_a_stall_sends_nothing(driver: MotionDriver, arm: Arm) -> None:
    arm.outcomes = [Outcome.STALLED]
    goal = pose_vector(transform(START[:3, 3] + (0.15, 0.0, 0.0), START[:3, :3]), 0.0)
    last = driver.send(goal, reading(arm.at, None))
    assert driver.send(np.full(10, np.nan, np.float32), reading(arm.at, None)).tobytes() == last.tobytes()
    assert len(arm.sent) == 1


closed: list[str] = []


@pytest.fixture(autouse=True)
def _nothing_closed() -> None:
    closed.clear()


class Resource:
    """A camera or client that fails where its name says so: ``fails`` on closing, ``missing`` on connecting."""

    width, height, use_rgb, is_connected = 8, 8, True, True
    server = SimpleNamespace(lockstep_fps=None)

    def __init__(self, name: str) -> None:
        self.name = name

    def connect(self) -> dict[str, Any]:
        if "missing" in self.name:
            raise RobotError(f"{self.name} is not there")
        return {}

    def disconnect(self) -> None:
        closed.append(self.name)
        if "fails" in self.name:
            raise OSError(f"{self.name} at closing")

    def request(self, *_: Any, **__: Any) -> dict[str, Any]:
        raise RobotError("the process does not answer")

    close = disconnect


def robot(folder: Path, *cameras: str) -> AdamanipFranka:
    config = AdamanipFrankaConfig(id="closing", calibration_dir=folder, box_lower=(0, 0, 0), box_upper=(1, 1, 1))
    made = AdamanipFranka(config)
    made.cameras = {name: Resource(name) for name in cameras}  # type: ignore[misc]
    made._make_client = lambda: Resource("arm")  # type: ignore[assignment,method-assign,return-value]
    made._open_session = lambda *_: ROBOTS.open("closing")  # type: ignore[assignment,method-assign]
    return made


def test_a_camera_that_fails_at_closing_leaves_no_other_open(tmp_path: Path) -> None:
    made = robot(tmp_path, "first fails", "second", "third fails")
    made.connect()
    with pytest.raises(OSError, match="first fails at closing"):
        made.disconnect()
    assert closed == ["arm", "first fails", "second", "third fails"]
    assert ROBOTS.find("closing") is None
    made.disconnect()
    assert len(closed) == 4


def test_an_error_of_closing_does_not_hide_the_one_of_connecting(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(RobotError, match="second missing is not there"):
        robot(tmp_path, "first fails", "second missing").connect()
    assert closed == ["arm", "first fails", "second missing"]
    assert "first fails at closing" in caplog.text


def test_a_device_that_fails_while_it_opens_is_closed() -> None:
    class Broken(AdamanipKeyboard):
        def _listen(self) -> Any:
            self._listener = Resource("keys")
            raise RobotError("no display")

        def _close(self) -> None:
            self._listener.disconnect()

    device = Broken(AdamanipKeyboardConfig())
    with pytest.raises(RobotError, match="no display"):
        device.connect()
    assert closed == ["keys"]
    assert not device.is_connected


def test_a_log_that_cannot_be_written_does_not_leave_the_twin_running(tmp_path: Path) -> None:
    twin = AdamanipFrankaSim(AdamanipFrankaSimConfig(camera=False, episode_log=str(tmp_path / "log.jsonl")))
    twin._client, twin._moved = Resource("simulator"), True  # type: ignore[assignment]
    with pytest.raises(RobotError, match="does not answer"):
        twin.disconnect()
    assert closed == ["simulator"]
    assert not twin.is_connected


def test_an_arm_that_fails_while_it_connects_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    backend: Any = Resource("arm missing")
    monkeypatch.setattr(server, "Connection", lambda _: SimpleNamespace(recv_bytes=bytes, send_bytes=len))
    monkeypatch.setattr(server, "decode", lambda *_: SimpleNamespace(capacities={}, options=None))
    monkeypatch.setattr(server, "map_mailboxes", lambda *_: {})
    monkeypatch.setattr(server.pkgutil, "resolve_name", lambda _: lambda *_: Served(backend))
    assert server.main(0, 0, "module:factory") == 1
    assert closed == ["arm missing"]
