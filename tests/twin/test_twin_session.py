"""LeRobot's own commands on the twin: what is recorded in lockstep, what a replay does, and how fast real time is."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from check_twin_session import accepted_targets, lines_of, mixed_training
from lerobot.utils.constants import DEFAULT_FEATURES

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, POSE, STATES
from lerobot_adamanip.contract.dense_codec import pose_of_delta
from lerobot_adamanip.contract.memory import MEMORY
from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, transform
from lerobot_adamanip.contract.schema import POSE_NAMES
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.episode.memory import Memory, stored_memory
from lerobot_adamanip.evaluation.record import read_log
from lerobot_adamanip.hardware.features import ARM, ARM_NAMES, SENT_NAMES, STAMP_NAME
from lerobot_env_adamanip.dense_env import DenseEnv
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

ROOT = Path(__file__).resolve().parents[2]
SEED, FPS, SIZE = 1000, 10, 64
TICK = 0.02
"""One control tick of the simulation [s]."""
TWIN = ("--robot.type=adamanip_franka_sim", "--robot.id=twin", "--robot.category=microwave", "--robot.clock=lockstep")

pytestmark = [pytest.mark.sim, pytest.mark.timeout(1800)]


def lerobot(name: str, *arguments: str) -> None:
    command = [str(Path(sys.executable).with_name(f"lerobot-{name}")), *arguments, "--play_sounds=false"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode == 0, done.stderr[-4000:]


def record(root: Path, *options: str) -> Path:
    robot = (*TWIN, f"--robot.seed={SEED}", f"--robot.image_size={SIZE}", "--teleop.type=adamanip_scripted")
    data = (
        "--dataset.repo_id=local/twin",
        f"--dataset.root={root}",
        "--dataset.num_episodes=1",
        f"--dataset.fps={FPS}",
    )
    rest = ("--dataset.reset_time_s=0", "--dataset.single_task=Open the microwave.", "--dataset.push_to_hub=false")
    lerobot("record", *robot, *data, *rest, *options)
    return root


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first two seconds of an episode."""
    return record(tmp_path_factory.mktemp("twin") / "short", "--dataset.episode_time_s=2")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes, the second of them locked."""
    root = tmp_path_factory.mktemp("twin") / "recorded"
    for resume, locked in (("false", "false"), ("true", "true")):
        hidden = f"--robot.hidden={{locked: {locked}}}"
        record(root, "--dataset.episode_time_s=3600", hidden, "--robot.depth=true", f"--resume={resume}")
    return root


def rows(root: Path) -> Any:
    import pandas

    return pandas.concat([pandas.read_parquet(file) for file in sorted((root / "data").rglob("*.parquet"))])


@pytest.mark.nightly
def test_the_scripted_device_opens_a_free_and_a_locked_door(recorded: Path) -> None:
    log = read_log(recorded.with_name("recorded.episodes.jsonl"))
    assert [each.episode for each in log] == [0, 1]
    assert [each.given_seed for each in log] == [SEED, SEED + 1]  # a resumed session continues the seeds
    assert [each.locked for each in log] == [False, True]
    assert [each.success for each in log] == [True, True]
    assert all(each.key_frames > 0 for each in log)


def test_a_second_of_the_twin_has_the_columns_of_simulated_demonstrations(short: Path) -> None:
    info = json.loads((short / "meta" / "info.json").read_text(encoding="utf-8"))
    assert info["total_episodes"] == 1
    assert info["fps"] == FPS
    assert info["robot_type"] == "adamanip_franka_sim"
    simulated = schema.dense_features(ACTION_NAMES[EE_DELTA], STATES[POSE], image_size=SIZE)

    def described(features: Any) -> dict[str, Any]:
        """Type, shape and names of each column, without LeRobot's own."""
        kept = {key: feature for key, feature in features.items() if key not in DEFAULT_FEATURES}
        return {key: [feature["dtype"], list(feature["shape"]), feature["names"]] for key, feature in kept.items()}

    columns = described(info["features"])
    assert columns.pop(ARM) == ["float32", [len(ARM_NAMES)], list(ARM_NAMES)]  # which no policy reads
    assert columns == described(simulated)
    hidden = ("locked", "hidden", "latch", "seed", "success", "stamp", "outcome", "clock")
    read = [name for key in ("observation.state", "action") for name in info["features"][key]["names"]]
    assert not [name for name in read if any(word in name for word in hidden)]


@pytest.mark.nightly
def test_a_recording_merges_with_simulated_demonstrations(short: Path, tmp_path: Path) -> None:
    simulated, both = tmp_path / "simulated", tmp_path / "both"
    dense = ("--control", "dense", "--category", "microwave", "--image-size", str(SIZE), "--objects", "0:1")
    assert main(["collect", str(simulated), *dense, "--episodes-per-object", "1"]) == 0
    assert main(["merge", str(simulated), str(short), "--out", str(both)]) == 0
    assert main(["check", str(both)]) == 0
    info = json.loads((both / "meta" / "info.json").read_text(encoding="utf-8"))
    assert info["total_episodes"] == 2
    assert ARM not in info["features"]
    assert len(rows(both)) == len(rows(short)) + len(rows(simulated))
    assert not (both / "meta" / "calibrations.json").exists()


def test_a_second_of_the_twin_has_the_units_of_simulated_demonstrations(short: Path) -> None:
    """Positions in metres, rotation vectors around the same reference, fingers in metres, deltas in their unit."""
    env = DenseEnv("microwave", observe_images=False)
    try:
        seen, _ = env.reset(seed=SEED)
        forth = env.action_toward(env.feedback.tcp_in_base, 1.0)
    finally:
        env.close()
    first = rows(short).iloc[0]
    np.testing.assert_allclose(first["observation.state"], seen["agent_pos"], atol=1e-5)
    np.testing.assert_allclose(first["action"], forth, atol=1e-3)


@pytest.mark.parametrize("name", ["short", pytest.param("recorded", marks=pytest.mark.nightly)])
def test_what_was_asked_is_what_was_sent_and_time_is_steps(name: str, request: pytest.FixtureRequest) -> None:
    for _, episode in rows(request.getfixturevalue(name)).groupby("episode_index"):
        assert len(episode) > 2  # how many rows two seconds give is the machine's to say
        states, actions, arm = (np.stack(episode[key].to_numpy()) for key in ("observation.state", "action", ARM))
        sent = arm[:, [ARM_NAMES.index(name) for name in SENT_NAMES]]
        stamps, success = arm[:, ARM_NAMES.index(STAMP_NAME)], episode[schema.SUCCESS].to_numpy()
        np.testing.assert_allclose(np.stack(episode[schema.EXECUTED].to_numpy()), actions, atol=1e-5)
        for state, action, accepted in zip(states, actions, sent[1:], strict=False):
            pose = transform(state[:3].astype(float), matrix_from_rotation_vector(state[3:6].astype(float)))
            np.testing.assert_allclose(pose_of_delta(action, pose), accepted, atol=1e-5)
        # A step is whole control ticks; it is 1 / FPS to within one of them, and none is lost.
        np.testing.assert_allclose(stamps - stamps[0], np.arange(len(stamps)) / FPS, atol=TICK + 1e-3)
        assert np.diff(stamps).max() < 1 / FPS + TICK + 0.005
        assert not success[0]
        assert success[-1] == (name == "recorded")  # it is opened
        assert episode[schema.DONE].to_numpy().tolist() == [False] * (len(episode) - 1) + [True]


@pytest.mark.nightly
def test_a_replay_opens_the_same_door_as_far(recorded: Path, tmp_path: Path) -> None:
    log = tmp_path / "replayed.jsonl"
    lerobot(
        "replay",
        *TWIN,
        f"--robot.seed={SEED + 1}",
        "--robot.hidden={locked: true}",
        "--robot.camera=false",
        f"--robot.episode_log={log}",
        "--dataset.repo_id=local/twin",
        f"--dataset.root={recorded}",
        "--dataset.episode=1",
    )
    (replayed,) = lines_of(log)
    before = lines_of(recorded.with_name("recorded.episodes.jsonl"))[1]
    assert replayed["success"] is True
    assert replayed["joints"] == before["joints"]  # to the last bit: equal steps give equal data, see docs/twin.md


@pytest.mark.nightly
def test_its_key_frames_hold_accepted_targets_and_train_beside_simulated_ones(recorded: Path, tmp_path: Path) -> None:
    def run(program: str, *arguments: str) -> Path:
        log = tmp_path / f"{program}.log"
        with log.open("ab") as said:
            command = [str(Path(sys.executable).with_name(program)), *arguments]
            done = subprocess.run(command, cwd=ROOT, stdout=said, stderr=said, check=False)
        assert done.returncode == 0, log.read_text()[-4000:]
        return log

    small = ("--image-size=64", "--objects=0:1", "--episodes-per-object=1")
    run("adamanip", "collect", str(tmp_path / "simulated"), "--category=microwave", *small)
    losses = mixed_training(run, recorded, tmp_path / "simulated", tmp_path, steps=20)
    assert len(losses) == 20
    assert all(np.isfinite(losses))
    run("adamanip", "keyframes", str(recorded), "--out", str(tmp_path / "converted"))
    assert accepted_targets(recorded, tmp_path / "converted")
    state = rows(tmp_path / "converted")["observation.state"]
    assert len(state) < len(rows(recorded)) / 10
    env = KeyframeEnv("microwave", observe_images=False)
    try:
        cameras = Dataset(tmp_path / "converted").table["camera"].to_pylist()
        for camera, record in zip(cameras, read_log(recorded.with_name("recorded.episodes.jsonl")), strict=True):
            env.reset(seed=record.seed)  # the camera stands elsewhere in each scene
            np.testing.assert_allclose(
                json.loads(camera)["extrinsics"], env.camera_parameters()["extrinsics"], atol=1e-6
            )
    finally:
        env.close()


@pytest.mark.nightly
def test_real_time_is_fast_enough_for_people() -> None:
    """One camera at 8 Hz or more, its frames at most 150 ms old (p95), fewer than 5 % of a 10 Hz loop's ticks late."""
    from lerobot_env_adamanip.twin.config_devices import AdamanipFrankaSimConfig
    from lerobot_env_adamanip.twin.franka_sim import AdamanipFrankaSim

    robot = AdamanipFrankaSim(AdamanipFrankaSimConfig(id="twin", category="microwave", seed=SEED))
    robot.connect()
    try:
        camera = robot.cameras["front"]
        goal = {name: robot.get_observation()[name] for name in POSE_NAMES}
        late, ages, numbers = 0, [], set()
        begun = due = time.perf_counter()
        while time.perf_counter() - begun < 60:
            robot.get_observation()
            frame = camera.latest_frame()
            ages.append(time.perf_counter() - frame.stamp)
            numbers.add(frame.number)
            robot.send_action(goal)
            due += 1 / FPS
            late += time.perf_counter() > due + 0.005
            time.sleep(max(0.0, due - time.perf_counter()))
        assert len(numbers) / 60 >= 8
        assert statistics.quantiles(ages, n=20)[-1] <= 0.150
        assert late / len(ages) < 0.05
    finally:
        robot.disconnect()


@pytest.mark.nightly
def test_a_recording_and_the_simulators_log_give_the_same_felt_tries(tmp_path: Path) -> None:
    """A locked door is pulled at, and opened after the button; the simulator gets what the twin was sent."""
    locked = "--robot.hidden={locked: true}"
    root = record(tmp_path / "felt", "--dataset.episode_time_s=3600", locked, "--robot.memory=events")
    episode = rows(root)
    states, actions, memory = (
        np.stack(episode[key].to_numpy()) for key in ("observation.state", schema.EXECUTED, MEMORY)
    )
    assert states.shape[1] == len(STATES[POSE])
    kinds: dict[str, Any] = {"control": "dense", "action": EE_DELTA, "fps": FPS}
    stored = list(stored_memory(states, actions, Memory(**kinds)))
    assert memory.tobytes() == np.stack([numbers for numbers, _ in stored]).tobytes()
    env = DenseEnv("microwave", observe_images=False, fps=FPS, memory="text", max_steps=len(actions) + 1)
    try:
        env.reset(seed=SEED, options={"hidden_overrides": {"locked": True}})
        simulated = [env.task_description]
        for action in actions[:-1]:
            env.step(action)
            simulated.append(env.task_description)
    finally:
        env.close()
    assert simulated[-1] == env.task + stored[-1][1]
    assert any("pulled: blocked" in said for said in simulated)
    assert "times: moved" in simulated[-1], "the door is pulled open"
    assert sum(env.task + words == said for said, (_, words) in zip(simulated, stored, strict=True)) > 0.95 * len(
        stored
    )
