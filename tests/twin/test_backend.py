"""The simulated arm behind the protocol of a real one: key frames to the bit, braking, stalls, pictures, resets."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.hardware.arm import ArmMode, ArmTarget, Execution
from lerobot_adamanip.hardware.arm_process.mailbox import create_memory, map_mailboxes
from lerobot_adamanip.hardware.calibration.on_hand import CameraOnHand
from lerobot_adamanip.hardware.camera_frames import simulated_calibration
from lerobot_adamanip.util.errors import RobotError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim.cameras import Cameras, Pair
from lerobot_env_adamanip.sim.twin import TICK, SapienBackend
from lerobot_env_adamanip.twin.process import SUCCESS_BOX, TwinOptions, frame_capacity

pytestmark = pytest.mark.sim
SEED, SIZE = 1000, 64
LOOK = {"camera": FRONT, "depth": True}
LOCKED = EnvironmentOptions(
    category="microwave", image_size=SIZE, observe_images=False, hidden_overrides={"locked": True}
)


@pytest.fixture(scope="module")
def boxes() -> Iterator[Any]:
    capacities = {**dict.fromkeys(CAMERAS, frame_capacity(SIZE)), SUCCESS_BOX: 64}
    memory = create_memory(capacities)
    yield map_mailboxes(memory, capacities)
    os.close(memory)


@pytest.fixture(scope="module")
def twin(boxes: Any) -> Iterator[SapienBackend]:
    backend = SapienBackend(TwinOptions(LOCKED, seed=SEED, lockstep=True), boxes)
    backend.connect()
    yield backend
    backend.close()
    backend.close()


def target(pose: Any, gripper: float, execution: Execution) -> ArmTarget:
    return ArmTarget(pose_vector(pose, gripper), execution, 0.0)


def play_key_frame(twin: SapienBackend, action: Any) -> int:
    """Ticks that it took."""
    twin.begin_keyframe(ArmTarget(action, Execution.KEYFRAME, 0.0))
    for ticks in range(2000):
        if twin.read().outcome is not None:
            return ticks
        twin.tick()
    raise AssertionError("a key frame without an end")


def test_key_frames_are_those_of_the_environment_to_the_bit(twin: SapienBackend) -> None:
    env = KeyframeEnv(options=LOCKED)
    try:
        env.reset(seed=SEED)
        twin.reset({"seed": SEED})
        expert = make_expert("microwave", "adaptive", env.annotations, generator=np.random.default_rng(0))
        goal = next(expert)
        for _ in range(8):  # past the pull at the locked door
            env.drive(goal.action())
            assert play_key_frame(twin, goal.action()) > 1
            np.testing.assert_array_equal(twin.env.joints(), env.joints())
            reading = twin.read()
            assert reading.outcome is env.feedback.outcome
            np.testing.assert_array_equal(reading.effort, env.episode.task.driver.effort)
            goal = expert.send(env.feedback)
        assert twin.episode({})["try_sequence"] == env.episode_record()["try_sequence"] == [[0, 1, True]]
    finally:
        env.close()


def test_a_key_frame_that_is_stopped_brakes_and_rests(twin: SapienBackend) -> None:
    twin.reset({"seed": SEED})
    start = twin.read()
    pose = start.tcp_in_base.copy()
    pose[1, 3] += 0.25
    twin.begin_keyframe(target(pose, 1.0, Execution.KEYFRAME))
    for _ in range(25):
        twin.tick()
    moving = twin.read()
    assert moving.mode is ArmMode.MOVING
    assert moving.outcome is None
    twin.stop()
    for _ in range(40):
        twin.tick()
    rest = twin.read()
    assert rest.mode is ArmMode.IDLE
    assert rest.outcome is None
    way = rest.tcp_in_base[1, 3] - moving.tcp_in_base[1, 3]
    assert 0.0 < way < 0.1  # it goes on by what braking takes
    assert rest.tcp_in_base[1, 3] < pose[1, 3] - 0.02


def test_time_goes_by_ticks_and_a_stream_is_followed(twin: SapienBackend) -> None:
    twin.reset({"seed": SEED})
    before = twin.read()
    pose = before.tcp_in_base.copy()
    for _ in range(50):
        pose[2, 3] += 0.001
        twin.stream(target(pose, 1.0, Execution.STREAM))
        twin.tick()
    for _ in range(30):
        twin.tick()
    after = twin.read()
    assert after.robot_time - before.robot_time == pytest.approx(80 * TICK)
    np.testing.assert_allclose(after.tcp_in_base[:3, 3], pose[:3, 3], atol=2e-3)
    assert after.outcome is None


def test_a_pull_at_a_locked_door_stalls_under_bounded_strain(twin: SapienBackend) -> None:
    told = twin.reset({"seed": SEED})
    handle = told["annotations"]["handle"]
    expert = make_expert("microwave", "adaptive", told["annotations"], generator=np.random.default_rng(0))
    goal = next(expert)
    for _ in range(3):  # before it, at it, closed
        play_key_frame(twin, goal.action())
        goal = expert.send(twin.env.feedback)
    pull = handle.moved({"door": 0.3})
    twin.stream(target(pull, 0.0, Execution.STREAM))
    for _ in range(150):
        twin.tick()
    assert twin.env.episode.task.driver.stalled
    assert twin.read().effort.__abs__().max() > 2.0
    assert abs(twin.env.part_positions()["door"]) < 0.02
    assert not twin.episode({})["success"]


def test_colour_and_depth_are_one_picture_and_rays_agree(twin: SapienBackend, boxes: Any) -> None:
    twin.reset({"seed": SEED})
    number = twin.look(LOOK)["number"]
    found = boxes[FRONT].read()
    assert found is not None
    frame = found[1]
    assert frame.number == number
    assert frame.color.shape == (SIZE, SIZE, 3)
    assert frame.depth.shape == (SIZE, SIZE)
    _, depth = twin.env.episode.task.cameras.color_and_depth("raycast")
    both = (frame.depth > 0) & (depth > 0)
    assert both.mean() > 0.2
    apart = np.abs(frame.depth.astype(int) - depth.astype(int))[both]
    assert np.percentile(apart, 90) <= 1


def test_a_camera_that_was_moved_is_found_by_the_hand_in_its_depth(boxes: Any, caplog: Any) -> None:
    environment = EnvironmentOptions(
        "safe", image_size=240, observe_images=False, sensing="exact,camera_error_mm=15,camera_error_deg=1"
    )
    moved = SapienBackend(TwinOptions(environment, seed=SEED, image_source="raycast", lockstep=True), boxes)
    moved.connect()
    try:
        camera = CameraOnHand(simulated_calibration(moved.describe()["camera"], "twin"))
        expert = make_expert("safe", "adaptive", moved.env.annotations, generator=np.random.default_rng(0))
        goal = next(expert)
        for _ in range(7):
            play_key_frame(moved, goal.action())
            cameras = moved.env.episode.task.cameras
            assert camera.update(cameras.color_and_depth("raycast")[1], moved.read())
            goal = expert.send(moved.env.feedback)
        assert "stands 1" in caplog.messages[-1]
        middle = np.array([0.55, 0.0, 0.765, 1.0])
        left = camera.estimate.correction @ cameras.errors.camera @ middle - middle
        assert np.linalg.norm(left) < 6e-3
    finally:
        moved.close()


@pytest.mark.parametrize("name", CAMERAS)
def test_each_camera_shows_the_picture_of_demonstrations(
    twin: SapienBackend, boxes: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(twin, "_options", replace(twin._options, image_source="raycast"))
    twin.reset({"seed": SEED})
    twin.look({"camera": name, "depth": False})
    seen = boxes[name].read()
    assert seen is not None
    np.testing.assert_array_equal(seen[1].color, twin.env.episode.task.cameras.raycast_image(name))
    assert seen[1].depth is None


@pytest.mark.parametrize("wrong", [{}, {"camera": "side", "depth": False}, {"camera": SUCCESS_BOX, "depth": False}])
def test_a_camera_that_is_not_there_is_refused(twin: SapienBackend, wrong: dict[str, Any]) -> None:
    with pytest.raises(RobotError, match="without a camera"):
        twin.look(wrong)


def test_a_picture_is_as_old_as_its_own_making(
    twin: SapienBackend, boxes: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, take = [], Cameras.color_and_depth

    def noted(cameras: Cameras, source: str) -> Pair:
        begun.append(time.perf_counter())
        return take(cameras, source)

    monkeypatch.setattr(Cameras, "color_and_depth", noted)
    for moment in (SEED, SEED + 1):
        twin.reset({"seed": moment})
        for _ in range(2):
            twin.look(LOOK)
            found = boxes[FRONT].read()
            assert found is not None
            before, last = begun[-2:]
            assert before < found[1].stamp <= last
    assert len(begun) == 6  # a scene's first picture, which takes ten times as long, is shown to nobody


def test_a_reset_tells_nothing_hidden_and_refuses_what_is_no_seed(twin: SapienBackend) -> None:
    told = twin.reset({"seed": SEED + 1})
    assert told["seed"] == SEED + 1
    assert set(told["annotations"]) == {"handle", "button"}
    assert not [key for key in told if "hidden" in key or "locked" in key]
    assert twin.episode({})["hidden_state"]["locked"] is True
    for wrong in (-1, 2**31, 1.5, True, None):
        with pytest.raises(ValueError, match="seed"):
            twin.reset({"seed": wrong})
