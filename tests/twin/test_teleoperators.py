"""Teleoperators of one tool goal, through fake devices: integration, anchors, clutch, time, what SDKs really say."""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from lerobot.teleoperators.utils import make_teleoperator_from_config
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.rotations import pose_from_vector, transform
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.contract.schema import SUCCESS as SUCCESS_COLUMN
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.dense_kinds import state_of
from lerobot_adamanip.hardware.robot_registry import LOCKSTEP_DT, OPERATOR_SUCCESS, RESET_WANTED, ROBOTS, RobotSession
from lerobot_adamanip.hardware.safety import SafetyFilter, SafetyLimits
from lerobot_adamanip.hardware.teleoperators.config_devices import (
    AdamanipGamepadConfig,
    AdamanipKeyboardConfig,
    AdamanipSpacemouseConfig,
    TcpTeleopConfig,
)
from lerobot_adamanip.hardware.teleoperators.devices import (
    GRIPPER,
    RESET,
    SHIFTS,
    SUCCESS,
    TURNS,
    AdamanipGamepad,
    AdamanipKeyboard,
    AdamanipSpacemouse,
)
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import MAX_PAUSE_S, Jog, JogTeleop, dead_zone
from lerobot_adamanip.util.errors import AdaManipError, RobotError
from lerobot_env_adamanip.twin.config_devices import AdamanipScriptedConfig

LEROBOT_KEYS = {"n", "r", "q", "left", "right", "up", "down", "esc", "space", "tab", "enter"}
DT = 1 / 30
LIMITS = SafetyLimits((-0.5, -1.0, -0.3), (1.3, 1.0, 1.5), speed=0.2, angular_speed=0.8)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


class Robot:
    """A robot on the board, that is where it is put."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.session: RobotSession = ROBOTS.open("arm")
        self.session.safety = LIMITS
        self.at(0.5, 0.0, 0.7)

    def at(self, *position: float) -> None:
        seven = np.zeros(7)
        self.session.reading = ArmReading(
            self.clock.now, self.clock.now, transform(position), 1.0, seven, seven, seven, ArmMode.IDLE
        )


class Stick(JogTeleop):
    """A device that asks for what it is told to."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(TcpTeleopConfig(), clock)
        self.jog = Jog()
        self.calls: list[str] = []

    def _open(self) -> None:
        self.calls.append("open")

    def _read(self) -> Jog:
        jog, self.jog = self.jog, replace(self.jog, toggle=False, success=False, reset=False)
        return jog

    def _close(self) -> None:
        self.calls.append("close")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def robot(clock: Clock) -> Iterator[Robot]:
    yield Robot(clock)
    ROBOTS.close("arm")


def call(teleop: Any, robot: Robot, *, follows: bool = True) -> Any:
    """One round of LeRobot's loop: time passes, the robot is observed, the teleoperator asked, the arm follows."""
    robot.clock.now += DT
    assert robot.session.reading is not None
    robot.session.reading = replace(robot.session.reading, stamp=robot.clock.now)
    action = teleop.get_action()
    assert tuple(action) == POSE_NAMES
    pose = np.array(list(action.values()), np.float32)
    if follows:
        robot.session.reading = replace(robot.session.reading, tcp_in_base=pose_from_vector(pose)[0])
    return pose


@pytest.fixture
def stick(clock: Clock) -> Stick:
    teleop = Stick(clock)
    teleop.connect()
    return teleop


def ahead(clutch: bool = True) -> Jog:
    return Jog(shift=np.array([1.0, 0.0, 0.0]), clutch=clutch)


def test_it_integrates_speed_times_time_and_turns_about_the_base_axes(robot: Robot, stick: Stick) -> None:
    call(stick, robot)
    stick.jog = Jog(shift=np.array([1.0, -0.5, 0.0]), turn=np.array([0.0, 0.0, 1.0]))
    poses = [call(stick, robot) for _ in range(30)]
    np.testing.assert_allclose(poses[-1][:3], (0.5 + 0.1, -0.05, 0.7), atol=1e-4)
    turned = Rotation.from_matrix(pose_from_vector(poses[-1])[0][:3, :3]).as_rotvec()
    np.testing.assert_allclose(turned, (0.0, 0.0, 0.4), atol=1e-3)


def test_what_it_returns_is_what_the_robots_own_filter_lets_through(robot: Robot, stick: Stick) -> None:
    """Idempotence at work: recorded and sent targets are equal bit for bit."""
    ours = SafetyFilter(LIMITS)
    stick.jog = Jog(shift=np.array([1.0, 0.3, -1.0]), turn=np.array([0.3, 0.2, -0.4]))
    for number in range(60):
        reading = robot.session.reading
        assert reading is not None
        sent = call(stick, robot, follows=number % 3 > 0)  # an arm that does not always follow
        if number == 0:
            ours.anchor(reading.tcp_in_base, reading.gripper)
        np.testing.assert_array_equal(ours.stream(sent, reading.tcp_in_base, DT), sent)


def test_an_episode_and_a_second_without_calls_anchor_anew(robot: Robot, clock: Clock, stick: Stick) -> None:
    stick.jog = ahead()
    for _ in range(10):
        call(stick, robot)
    robot.session.episodes += 1
    robot.at(0.4, 0.2, 0.8)
    np.testing.assert_allclose(call(stick, robot)[:3], (0.4, 0.2, 0.8), atol=1e-6)
    clock.now += MAX_PAUSE_S + 0.1
    robot.at(0.45, 0.1, 0.7)
    np.testing.assert_allclose(call(stick, robot)[:3], (0.45, 0.1, 0.7), atol=1e-6)


@pytest.mark.parametrize("begins", ["episode", "pause", "reset"])
def test_a_new_anchor_leaves_the_gripper_as_commanded(robot: Robot, clock: Clock, stick: Stick, begins: str) -> None:
    """Closed fingers that hold a wide part are measured as open."""
    call(stick, robot)
    stick.jog = Jog(toggle=True)
    robot.session.sent = call(stick, robot)
    assert robot.session.reading is not None
    robot.session.reading = replace(robot.session.reading, gripper=0.62)
    if begins == "reset":
        stick.reset()
    robot.session.episodes += begins == "episode"
    clock.now += MAX_PAUSE_S + 0.1 if begins == "pause" else 0.0
    assert [stick.get_action()["gripper.pos"], *(call(stick, robot)[9] for _ in range(3))] == [0.0] * 4


def test_the_first_anchor_waits_for_a_reading_newer_than_the_reset(robot: Robot, clock: Clock, stick: Stick) -> None:
    call(stick, robot)
    stick.reset()
    stick.jog = ahead()
    clock.now += DT
    stick.get_action()
    assert stick._filter is None  # the reading is from before
    call(stick, robot)
    assert stick._filter is not None


def test_the_clutch_holds_the_goal_and_closing_it_begins_at_the_measured_pose(robot: Robot, stick: Stick) -> None:
    call(stick, robot)
    stick.jog = ahead(clutch=False)
    assert call(stick, robot)[0] == pytest.approx(0.5)
    robot.at(0.52, 0.0, 0.7)  # pushed a little
    stick.jog = ahead()
    assert call(stick, robot)[0] == pytest.approx(0.52, abs=1e-6)
    assert call(stick, robot)[0] == pytest.approx(0.52 + 0.1 * DT, abs=1e-5)


def test_in_lockstep_steps_are_the_time_and_not_the_clock(robot: Robot, clock: Clock, stick: Stick) -> None:
    robot.session.details[LOCKSTEP_DT] = 0.01
    call(stick, robot)
    stick.jog = ahead()
    assert call(stick, robot)[0] - 0.5 == pytest.approx(0.1 * 0.01, abs=1e-6)
    clock.now += 60.0  # a slow machine
    assert call(stick, robot)[0] - 0.5 == pytest.approx(2 * 0.1 * 0.01, abs=1e-6)


def test_the_gripper_toggles_and_keys_reach_the_robot(robot: Robot, stick: Stick) -> None:
    assert call(stick, robot)[9] == 1.0
    stick.jog = Jog(toggle=True, success=True, reset=True)
    assert call(stick, robot)[9] == 0.0
    assert call(stick, robot)[9] == 0.0
    assert robot.session.details[OPERATOR_SUCCESS] is True
    assert robot.session.details[RESET_WANTED] is True
    robot.session.episodes += 1
    call(stick, robot)
    assert not robot.session.details[OPERATOR_SUCCESS]


@pytest.mark.parametrize("begins", ["episode", "pause"])
def test_the_success_key_marks_what_the_operator_does_until_the_next_take_over(
    robot: Robot, clock: Clock, stick: Stick, begins: str
) -> None:
    session = robot.session

    def marked(*, by_hand: bool = True) -> bool:
        reading = session.reading
        assert reading is not None
        session.observe(reading, clock.now)
        session.act(call(stick, robot, follows=False) if by_hand else session.sent, reading)
        return bool(session.rows.find(state_of(session.state, reading))[SUCCESS_COLUMN][0])

    assert not marked()
    stick.jog = Jog(success=True)
    assert [marked() for _ in range(3)] == [True] * 3
    assert not marked(by_hand=False)  # a policy goes on
    session.episodes += begins == "episode"
    clock.now += MAX_PAUSE_S + 0.1 if begins == "pause" else 0.0
    assert [marked() for _ in range(2)] == [False] * 2


def test_without_a_robot_or_a_connection_it_says_so(stick: Stick) -> None:
    with pytest.raises(RobotError, match="finds no robot"):
        stick.get_action()
    stick.disconnect()
    stick.disconnect()
    assert stick.calls == ["open", "close"]
    with pytest.raises(RobotError, match="not connected"):
        stick.get_action()


def test_a_dead_zone_is_continuous_and_keeps_full_deflection() -> None:
    values = np.array([-1.0, -0.1, 0.05, 0.1, 0.55, 1.0])
    np.testing.assert_allclose(dead_zone(values, 0.1), [-1.0, 0.0, 0.0, 0.0, 0.5, 1.0])


CONFIGS = (AdamanipKeyboardConfig, AdamanipGamepadConfig, AdamanipSpacemouseConfig)


@pytest.mark.parametrize("config", [*CONFIGS, AdamanipScriptedConfig])
def test_lerobot_finds_each_device_beside_its_options(config: type[TcpTeleopConfig]) -> None:
    made = make_teleoperator_from_config(config())
    assert made.config_class is config
    assert config.get_choice_name(config) == made.name


# Devices --------------------------------------------------------------------------------------------------------------


@pytest.fixture
def pad() -> Any:
    pad = types.SimpleNamespace(axes=(0.0,) * 6, buttons=set(), init=lambda: None, get_instance_id=lambda: 3)
    pad.get_numhats, pad.get_hat, pad.get_numbuttons = (lambda: 1), (lambda _: (0, 0)), (lambda: 11)
    pad.get_axis, pad.get_button = (lambda number: pad.axes[number]), (lambda number: number in pad.buttons)
    return pad


@pytest.fixture
def pygame(monkeypatch: pytest.MonkeyPatch, pad: Any) -> Any:
    module: Any = types.ModuleType("pygame")
    module.init = module.quit = lambda: None
    module.JOYDEVICEREMOVED, module.removed, module.pads = 1542, [], [pad]
    module.joystick = types.SimpleNamespace(
        init=lambda: None, get_count=lambda: len(module.pads), Joystick=lambda index: module.pads[index]
    )
    module.event = types.SimpleNamespace(get=lambda kind: module.removed)
    monkeypatch.setitem(sys.modules, "pygame", module)
    return module


def test_gamepad_drives_only_while_its_shoulder_is_held(robot: Robot, clock: Clock, pygame: Any, pad: Any) -> None:
    teleop = AdamanipGamepad(AdamanipGamepadConfig(), clock)
    teleop.connect()
    pad.axes = (0.0, -1.0, 0.0, 0.05, 0.0, 0.0)  # left stick forward, the right one worn
    for _ in range(3):
        assert call(teleop, robot)[0] == pytest.approx(0.5)
    pad.buttons = {5}
    call(teleop, robot)
    assert call(teleop, robot)[0] == pytest.approx(0.5 + 0.1 * DT, abs=1e-5)
    pad.buttons = {5, 0}
    assert [call(teleop, robot)[9] for _ in range(3)] == [0.0, 0.0, 0.0]  # held, it toggles once
    pad.buttons = {5}
    call(teleop, robot)
    pad.buttons = {5, 0}
    assert call(teleop, robot)[9] == 1.0
    pygame.removed.append(types.SimpleNamespace(instance_id=7))  # another pad
    call(teleop, robot)
    pygame.removed.append(types.SimpleNamespace(instance_id=3))  # unplugged: its last values stay
    with pytest.raises(RobotError, match="gamepad is gone"):
        call(teleop, robot)
    teleop.disconnect()


def test_a_device_or_library_that_is_missing_is_named(pygame: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pygame.pads.clear()
    with pytest.raises(RobotError, match="no such gamepad"):
        AdamanipGamepad(AdamanipGamepadConfig()).connect()
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(RobotError, match=r"lerobot\[gamepad\]"):
        AdamanipGamepad(AdamanipGamepadConfig()).connect()
    monkeypatch.setitem(sys.modules, "pyspacemouse", None)
    with pytest.raises(RobotError, match="hidapi"):
        AdamanipSpacemouse(AdamanipSpacemouseConfig()).connect()


@pytest.fixture
def mouse(monkeypatch: pytest.MonkeyPatch) -> Any:
    """As pyspacemouse's: one report a read, the same object each time, and a time that stands when there is none."""
    axes = dict.fromkeys(("t", "x", "y", "z", "roll", "pitch", "yaw"), 0.0)
    state = types.SimpleNamespace(**axes, buttons=[0, 0])

    def read() -> Any:
        if device.queue:
            vars(state).update(device.queue.pop(0))
            state.t += 1.0
        return state

    def close() -> None:
        device.closed = True

    device: Any = types.SimpleNamespace(queue=[], closed=False, read=read, close=close)
    module: Any = types.ModuleType("pyspacemouse")
    module.AxisConvention = types.SimpleNamespace(ROS="ros")
    module.open = lambda device_index, axis_convention: device if axis_convention == "ros" else None
    monkeypatch.setitem(sys.modules, "pyspacemouse", module)
    return device


@pytest.fixture
def spacemouse(clock: Clock, mouse: Any) -> AdamanipSpacemouse:
    teleop = AdamanipSpacemouse(AdamanipSpacemouseConfig(), clock)
    teleop.connect()
    return teleop


def test_spacemouse_takes_all_reports(robot: Robot, mouse: Any, spacemouse: AdamanipSpacemouse) -> None:
    call(spacemouse, robot)
    mouse.queue = [{"x": 0.2}, {"x": 0.6}, {"x": 1.0, "y": 0.02}, {"buttons": [1, 0]}]
    pose = call(spacemouse, robot)
    np.testing.assert_allclose(pose[:3], (0.5 + 0.1 * DT, 0.0, 0.7), atol=1e-5)
    assert pose[9] == 0.0
    assert call(spacemouse, robot)[9] == 0.0  # still held
    mouse.read = lambda: 1 / 0
    with pytest.raises(RobotError, match="cannot be read"):
        call(spacemouse, robot)
    spacemouse.disconnect()
    assert mouse.closed


def test_a_spacemouse_that_falls_silent_while_deflected_rests_within_half_a_second_and_is_then_an_error(
    robot: Robot, clock: Clock, mouse: Any, spacemouse: AdamanipSpacemouse
) -> None:
    """A cable that is pulled: the library goes on telling the last deflection. At rest it may be silent."""
    for _ in range(90):
        assert call(spacemouse, robot)[0] == pytest.approx(0.5)
    for silent in (0.4, 0.9):  # the first time it reports again
        mouse.queue = [{"x": 1.0}]
        moved_at, before = clock.now, call(spacemouse, robot)[0]
        silent_since = clock.now
        while clock.now < silent_since + silent:
            pose = call(spacemouse, robot)
            moved_at, before = (clock.now, pose[0]) if pose[0] > before else (moved_at, before)
        assert 0.05 < moved_at - silent_since < 0.5 - 2 * DT
    clock.now += 0.1
    with pytest.raises(RobotError, match="does not report any more"):
        call(spacemouse, robot)


def test_keyboard_keys_are_none_of_lerobots() -> None:
    ours = {*SHIFTS, *TURNS, GRIPPER, SUCCESS, RESET}
    assert len(ours) == len(SHIFTS) + len(TURNS) + 3
    assert ours.isdisjoint(LEROBOT_KEYS)
    for table in (SHIFTS, TURNS):
        assert sorted(table.values()) == sorted((axis, sign) for axis in range(3) for sign in (-1.0, 1.0))


class Keys(AdamanipKeyboard):
    def _listen(self) -> Any:
        return types.SimpleNamespace(is_alive=lambda: True, stop=lambda: None)


@pytest.fixture
def keys(clock: Clock) -> Keys:
    keys = Keys(AdamanipKeyboardConfig(), clock)
    keys.connect()
    return keys


def test_keyboard_drives_while_keys_and_the_clutch_are_held(robot: Robot, keys: Keys) -> None:
    call(keys, robot)
    keys.press("shift_r")
    call(keys, robot)  # the clutch closes at the measured pose
    keys.press("w")
    keys.press("u")
    keys.press("g")
    keys.press("g")  # a key that is held repeats
    pose = call(keys, robot)
    np.testing.assert_allclose(pose[:3], (0.5 + 0.1 * DT, 0.0, 0.7 + 0.1 * DT), atol=1e-5)
    assert pose[9] == 0.0
    keys.release("shift_r")
    stands = call(keys, robot)
    np.testing.assert_array_equal(call(keys, robot), stands)  # the letters are still held
    keys.release("w")
    keys.release("u")
    keys.press("shift_r")
    keys.press("backspace")
    call(keys, robot)
    assert robot.session.details[RESET_WANTED] is True


def test_text_that_is_typed_in_any_window_moves_nothing_and_labels_nothing(robot: Robot, keys: Keys) -> None:
    start = call(keys, robot)
    for letter in "why would anybody judge a safe":
        keys.press(letter)
        np.testing.assert_array_equal(call(keys, robot), start)
        keys.release(letter)
    keys.press("shift_r")
    call(keys, robot)
    assert not robot.session.details[OPERATOR_SUCCESS]


def test_a_keyboard_whose_listener_has_ended_is_an_error(robot: Robot, keys: Keys) -> None:
    """Keys that were held then would be so for ever."""
    call(keys, robot)
    keys._listener = types.SimpleNamespace(is_alive=lambda: False, stop=lambda: None)
    with pytest.raises(RobotError, match="not listened to"):
        call(keys, robot)


def test_a_clutch_key_that_sends_shortcuts_is_refused() -> None:
    with pytest.raises(AdaManipError, match="shift_r"):
        AdamanipKeyboardConfig(clutch_key="ctrl")
