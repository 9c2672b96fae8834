"""The real arm's backend with stand-ins: what is written before it moves, how a key frame ends, the gripper."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Outcome
from lerobot_adamanip.contract.rotations import pose_vector, rotation_about, transform
from lerobot_adamanip.hardware.arm import ArmMode
from lerobot_adamanip.hardware.backends import franky
from lerobot_adamanip.hardware.backends.franky import OutcomeWatch
from lerobot_adamanip.hardware.backends.franky_options import MODELS, FrankyOptions
from lerobot_adamanip.hardware.backends.franky_sdk import (
    check_joints,
    check_tool_frame,
    connect_robot,
    flags_of,
    reading_of,
    scaled_limits,
    set_limits,
)
from lerobot_adamanip.hardware.backends.gripper import GripperThread
from lerobot_adamanip.util.errors import RobotError

VALUES = {"address": "172.16.0.2", "model": "fr3"}


class Limit:
    """As franky's: no more than it believes the arm can do."""

    def __init__(self, highest: float, *, loses: float = 0.0) -> None:
        self.max, self._value, self._loses = highest, None, loses

    def set(self, value: Any) -> None:
        assert np.max(value) <= self.max
        self._value = np.asarray(value) - self._loses

    def get(self) -> Any:
        return self._value


def robot(highest: float, loses: float = 0.0) -> Any:
    return SimpleNamespace(**{name: Limit(highest, loses=loses) for name in scaled_limits(FrankyOptions(model="fr3"))})


@pytest.mark.parametrize("model", MODELS)
def test_what_is_read_back_is_our_table_times_the_dynamics(model: str) -> None:
    options = FrankyOptions(model=model, dynamics=0.05)
    read = set_limits(robot(1e9), options)
    assert read == scaled_limits(options)
    assert read["translation_velocity_limit"] == [MODELS[model]["translation_velocity"] * 0.05]
    assert read["joint_acceleration_limit"] == pytest.approx(np.array(MODELS[model]["joint_acceleration"]) * 0.05)
    assert len(read) == 12


def test_a_limit_that_the_library_believes_to_be_lower_stays_lower_and_one_that_does_not_stick_is_an_error() -> None:
    options = FrankyOptions(model="fr3", dynamics=1.0)
    assert set_limits(robot(1.7), options)["translation_velocity_limit"] == [1.7]
    with pytest.raises(RobotError, match="was set to"):
        set_limits(robot(1e9, loses=0.001), options)


def in_flange(z: float, degrees: float) -> Any:
    tool = transform((0.0, 0.0, z), rotation_about((0, 0, 1), np.deg2rad(degrees)))
    return SimpleNamespace(F_T_EE=SimpleNamespace(matrix=tool))


def test_only_the_hands_tool_frame_is_taken() -> None:
    hand = np.array((0.7071, -0.7071, 0, 0, 0.7071, 0.7071, 0, 0, 0, 0, 1, 0, 0, 0, 0.1034, 1)).reshape(4, 4).T
    check_tool_frame(SimpleNamespace(F_T_EE=SimpleNamespace(matrix=hand)))  # as libfranka tells it, by columns
    for z, degrees in ((0.0, 0.0), (0.1034, 0.0), (0.0, -45.0), (0.107, -45.0), (0.1034, 45.0)):
        with pytest.raises(RobotError, match=r"(?s)not the Franka Hand.*in Desk"):
            check_tool_frame(in_flange(z, degrees))


@pytest.mark.parametrize("gripper", [False, True])  # the hand must be mounted, commanded or not
def test_a_wrong_tool_frame_is_refused_before_anything_is_written(
    monkeypatch: pytest.MonkeyPatch, gripper: bool
) -> None:
    arm = SimpleNamespace(state=in_flange(0.0, 0.0))  # any other attribute is an error
    monkeypatch.setattr(franky, "import_franky", SimpleNamespace)
    monkeypatch.setattr(franky, "connect_robot", lambda *_: arm)
    with pytest.raises(RobotError, match="not the Franka Hand"):
        franky.FrankyBackend(FrankyOptions(**VALUES, gripper=gripper)).connect()


def test_an_arm_outside_the_models_range_is_another_arm() -> None:
    panda = np.array((0.0, -0.3, 0.0, -2.2, 0.0, 0.3, 0.8))  # an FR3's joint 6 begins at 0.54
    check_joints(panda, FrankyOptions(model="panda"))
    with pytest.raises(RobotError, match="not within the range of a fr3"):
        check_joints(panda, FrankyOptions(model="fr3"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": ""}, "address"),
        ({"address": "a b"}, "address"),
        ({"model": "fer"}, "fr3, panda"),
        ({"dynamics": 2.0}, "dynamics"),
        ({"stiffness": 5000.0}, "stiffness"),
        ({"effort_sign": 0.5}, "effort_sign"),
        ({"stall_force": 70.0}, "before the arm's reflex"),
        ({"dynamics": 0.05}, "up to 67 N until a blocked arm has braked"),  # an FR3's; a Panda's are lower
        ({"grasp_force": float("nan")}, "grasp_force"),
    ],
)
def test_options_that_cannot_be_meant_are_refused_by_name(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FrankyOptions(**{**VALUES, **options}).check()


def state(**values: Any) -> Any:
    pose = np.eye(4)
    plain = {
        "time": SimpleNamespace(to_msec=lambda: 1500), "O_T_EE": SimpleNamespace(matrix=pose), "q": np.arange(7.0),
        "dq": np.zeros(7), "tau_ext_hat_filtered": np.arange(7.0), "robot_mode": SimpleNamespace(name="Reflex"),
        "current_errors": SimpleNamespace(joint_reflex=True, cartesian_reflex=True, self_collision=False, text="x"),
    }  # fmt: skip
    return SimpleNamespace(**{**plain, **values})


def test_a_state_is_told_in_our_words() -> None:
    reading = reading_of(state(), 0.4, -1.0, Outcome.STALLED)
    assert reading.robot_time == 1.5
    assert reading.mode is ArmMode.REFLEX
    assert reading.errors == ("cartesian_reflex", "joint_reflex")
    assert reading.outcome is Outcome.STALLED
    assert (reading.effort == -np.arange(7.0)).all()
    assert (reading.gripper, reading.qpos.shape, reading.qvel.shape) == (0.4, (7,), (7,))
    assert reading_of(state(robot_mode=SimpleNamespace(name="NewMode")), 1.0, 1.0, None).mode is ArmMode.OTHER


def test_the_real_librarys_flags_are_found_by_name() -> None:
    import franky

    names = [name for name in dir(franky.Errors()) if not name.startswith("_")]
    assert {"joint_reflex", "cartesian_reflex", "communication_constraints_violation"} <= set(names)
    assert flags_of(franky.Errors()) == ()


def test_an_arm_that_is_not_there_is_one_clear_error_with_a_hint() -> None:
    import franky

    with pytest.raises(RobotError, match=r"(?s)No connection to the arm at 127\.0\.0\.1.*try:.*address right"):
        connect_robot(franky, FrankyOptions(address="127.0.0.1", model="fr3", realtime=False))


STALL_TICKS = DEFAULT_MOTION.stall_ticks
GOAL = transform((0.5, 0.0, 0.4))
TICK = 0.02


def watch(time_limit: float = 10.0) -> OutcomeWatch:
    return OutcomeWatch(GOAL, FrankyOptions(), 0.0, time_limit)


def behind(lag: float = 0.0, angle: float = 0.0) -> np.ndarray:
    return transform((0.5 - lag, 0.0, 0.4), rotation_about((0, 0, 1), angle))


@pytest.mark.parametrize("pose", [behind(lag=0.031), behind(angle=0.028)])
def test_a_tool_that_is_held_back_for_some_ticks_stalls(pose: np.ndarray) -> None:
    looking = watch()
    outcomes = [looking.look(pose, GOAL, running=True, speed=0.0, now=k * TICK) for k in range(STALL_TICKS)]
    assert outcomes == [None] * (STALL_TICKS - 1) + [Outcome.STALLED]


def test_an_arm_that_releases_what_it_pressed_on_does_not_stall_until_it_presses_again() -> None:
    looking = OutcomeWatch(GOAL, FrankyOptions(), 0.0, 10.0, leaning=True)
    lags = [0.06, 0.05, 0.045, 0.04, 0.035, 0.031, 0.02, *[0.031] * STALL_TICKS]
    outcomes = [looking.look(behind(lag), GOAL, running=True, speed=0.1, now=k * TICK) for k, lag in enumerate(lags)]
    assert outcomes == [None] * (len(lags) - 1) + [Outcome.STALLED]


@pytest.mark.parametrize(
    "desired", [transform((0.02, 0.0, 0.0)), transform((0, 0, 0), rotation_about((0, 0, 1), 0.03))]
)
def test_a_key_frame_after_a_blocked_one_first_releases(monkeypatch: pytest.MonkeyPatch, desired: np.ndarray) -> None:
    backend, moves = at_rest(desired, monkeypatch)
    backend.begin_keyframe(SimpleNamespace(pose=pose_vector(transform((0.0, 0.0, 0.1)), 1.0)))
    ((points, leaning),) = moves
    assert [point[2, 3] for point in points] == pytest.approx([0.0, 0.1])
    assert leaning


def test_a_jerk_is_no_stall() -> None:
    looking = watch()
    for k in range(50):
        lag = 0.029 if k % STALL_TICKS == 0 else 0.04
        assert looking.look(behind(lag), GOAL, running=True, speed=0.1, now=k * TICK) is None


def test_a_motion_that_ended_at_its_goal_is_reached_as_soon_as_it_rests() -> None:
    looking = watch()
    assert looking.look(behind(0.001), GOAL, running=False, speed=0.1, now=1.0) is None
    assert looking.look(behind(0.001), GOAL, running=False, speed=0.0, now=1.02) is Outcome.REACHED


def test_an_arm_that_follows_late_gets_half_a_second() -> None:
    for lag, outcome in ((0.011, Outcome.REACHED), (0.02, Outcome.STALLED)):
        looking = watch()
        told = [looking.look(behind(lag), GOAL, running=False, speed=0.0, now=now) for now in (1.0, 1.49, 1.51)]
        assert told == [None, None, outcome]


def test_a_motion_that_begins_late_is_not_taken_for_one_that_ended() -> None:
    looking = watch()
    assert looking.look(behind(0.02), behind(0.02), running=False, speed=0.0, now=0.0) is None
    for k in range(1, 100):
        assert looking.look(behind(0.02), behind(0.02), running=True, speed=0.1, now=k * TICK) is None
    assert looking.look(behind(0.02), GOAL, running=False, speed=0.1, now=2.0) is None


def test_a_motion_without_end_is_given_up() -> None:
    looking = watch(time_limit=2.0)
    assert looking.look(behind(0.01), behind(0.01), running=True, speed=0.1, now=1.99) is None
    assert looking.look(behind(0.01), behind(0.01), running=True, speed=0.1, now=2.01) is Outcome.TIMEOUT


def at_rest(desired: np.ndarray, monkeypatch: pytest.MonkeyPatch, **options: Any) -> tuple[Any, list[Any]]:
    """A backend whose tool is at the base, and a list of its key frames: the points, and whether it was leaning."""
    moves: list[Any] = []
    monkeypatch.setattr(franky, "OutcomeWatch", lambda *values: moves.append(values))
    backend = franky.FrankyBackend(FrankyOptions(**VALUES, **options))
    backend._state = state(O_T_EE_d=SimpleNamespace(matrix=desired))
    errors = {"ControlException": OSError, "NetworkException": OSError}
    motions = {"CartesianWaypoint": np.array, "CartesianWaypointMotion": lambda points, **_: points}
    backend._franky = SimpleNamespace(Affine=np.array, **motions, **errors)
    backend._robot = SimpleNamespace(move=lambda points, **_: moves.append((points, moves.pop()[-1])))
    return backend, moves


def test_a_slow_motion_has_time_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """1 rad at 1 % of 2.5 rad/s takes 40 s."""
    limits: list[float] = []
    for dynamics in (0.01, 1.0):
        backend, _ = at_rest(np.eye(4), monkeypatch, dynamics=dynamics)
        monkeypatch.setattr(franky, "OutcomeWatch", lambda *values: limits.append(values[3]))
        backend._robot.move = lambda *_, **__: None
        backend.begin_keyframe(
            SimpleNamespace(pose=pose_vector(transform((0, 0, 0), rotation_about((0, 0, 1), 1.0)), 1.0))
        )
    assert limits[0] > 40.0
    assert limits[1] < 5.0, "a blocked motion ends after seconds"


class SlowHand:
    """Waits for `go_on`, and writes down what it was told."""

    def __init__(self, opening: float = 1.0) -> None:
        self.told: list[str] = []
        self.width, self.fails = opening, False
        self.go_on = threading.Event()
        self.go_on.set()

    def open(self) -> None:
        self._do("open", 1.0)

    def close(self) -> None:
        self._do("close", 0.2)

    def _do(self, what: str, width: float) -> None:
        self.told.append(what)
        self.go_on.wait(20)
        if self.fails:
            raise OSError("the hand is gone")
        self.width = width

    def opening(self) -> float:
        return self.width

    def stop(self) -> None:
        self.told.append("stop")
        self.go_on.set()


@pytest.fixture
def hand() -> SlowHand:
    return SlowHand()


@pytest.fixture
def gripper(hand: SlowHand) -> Iterator[GripperThread]:
    thread = GripperThread(lambda: hand)
    thread.start()
    yield thread
    hand.go_on.set()
    thread.close()


def until(condition: Callable[[], bool]) -> None:
    end = time.perf_counter() + 20
    while not condition():
        assert time.perf_counter() < end
        time.sleep(0.005)


def test_a_stream_of_openings_is_few_commands(gripper: GripperThread, hand: SlowHand) -> None:
    for opening in (1.0, 0.9, 0.6, 0.5, 0.46, 0.44, 0.3, 0.0, 0.2, 0.5, 0.54):
        gripper.want(opening)
    until(lambda: not gripper.busy)
    until(lambda: gripper.opening == 0.2)
    assert hand.told == ["close"]
    gripper.want(0.56)
    until(lambda: gripper.opening == 1.0)
    assert hand.told == ["close", "open"]


def test_wanting_never_waits_only_the_newest_is_carried_out_and_the_fingers_are_seen_meanwhile(
    gripper: GripperThread, hand: SlowHand
) -> None:
    """A command takes up to 0.9 s."""
    hand.go_on.clear()
    gripper.want(0.0)
    until(lambda: hand.told == ["close"])
    began = time.perf_counter()
    for opening in 1000 * (1.0, 0.0, 1.0):
        gripper.want(opening)
    assert (time.perf_counter() - began) / 3000 < 0.005
    for width in (0.8, 0.5, 0.3):
        hand.width = width
        until(lambda width=width: gripper.opening == width)  # type: ignore[misc]
    assert gripper.busy
    hand.go_on.set()
    until(lambda: not gripper.busy)
    assert hand.told == ["close", "open"]
    assert gripper.opening == 1.0


def test_a_wish_during_a_command_that_undoes_it_is_carried_out(gripper: GripperThread, hand: SlowHand) -> None:
    """No further target comes."""
    gripper.want(1.0)
    hand.go_on.clear()
    gripper.want(0.0)
    until(lambda: hand.told == ["close"])
    gripper.want(1.0)
    hand.go_on.set()
    until(lambda: hand.told == ["close", "open"])
    until(lambda: not gripper.busy)
    assert gripper.opening == 1.0


def test_the_first_wish_is_carried_out_unless_fingers_are_wide_open() -> None:
    """Fingers that are closed may not hold: they are told to."""
    for opening, wanted, told in ((1.0, 1.0, []), (0.5, 1.0, ["open"]), (0.0, 0.0, ["close"]), (0.5, 0.5, [])):
        hand = SlowHand(opening)
        gripper = GripperThread(lambda hand=hand: hand)  # type: ignore[misc]
        gripper.start()
        gripper.want(wanted)
        until(lambda gripper=gripper: not gripper.busy)  # type: ignore[misc]
        assert hand.told == told
        gripper.close()


def test_a_hand_that_fails_is_told_and_can_be_forgiven(gripper: GripperThread, hand: SlowHand) -> None:
    hand.fails = True
    gripper.want(0.0)
    until(lambda: not gripper.busy)
    with pytest.raises(RobotError, match="the hand is gone"):
        gripper.check()
    hand.fails = False
    gripper.forgive()
    gripper.check()
    gripper.want(0.0)
    until(lambda: gripper.opening == 0.2)


def test_a_hand_that_is_not_there_is_an_error_of_connecting() -> None:
    def connect() -> SlowHand:
        raise OSError("no hand")

    with pytest.raises(RobotError, match="OSError: no hand"):
        GripperThread(connect).start()


def test_closing_ends_a_command_under_way(gripper: GripperThread, hand: SlowHand) -> None:
    hand.go_on.clear()
    gripper.want(0.0)
    until(lambda: hand.told == ["close"])
    began = time.perf_counter()
    gripper.close()
    assert hand.told[-1] == "stop"
    assert time.perf_counter() - began < 2.0
