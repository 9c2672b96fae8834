from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from envs_helpers import SMALL, digest, expert_episode, grasp_handle, in_fresh_process, stay

from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.contract.seeds import split_of
from lerobot_adamanip.evaluation.record import read_log
from lerobot_adamanip.experts import Phase
from lerobot_adamanip.util.errors import ConfigurationError, UnreachableError
from lerobot_env_adamanip.keyframe_env import SCENE_TRIES, EpisodeLog, KeyframeEnv

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def env() -> Iterator[KeyframeEnv]:
    made = KeyframeEnv("safe", max_key_frames=30, **SMALL)
    yield made
    made.close()


# Gymnasium's contract ---------------------------------------------------------------------------------------------


def check_observation(env: KeyframeEnv, observation: dict[str, Any]) -> None:
    assert env.observation_space.contains(observation)
    assert observation["pixels"]["front"].dtype == np.uint8
    for key in ("agent_pos", "effort", "point_cloud"):
        assert observation[key].dtype == np.float32
        assert np.isfinite(observation[key]).all()


def test_what_lerobot_asks_of_an_environment(env: KeyframeEnv) -> None:
    assert env.task == env.task_description == "Open the safe."
    assert env._max_episode_steps == 30
    assert env.metadata["render_fps"] > 0
    observation, _ = env.reset(seed=5, options={"lerobot_new_rollout": True})
    frame = env.render()
    assert frame.shape == (64, 64, 3)
    assert np.array_equal(frame, observation["pixels"]["front"])
    frame[:] = 0  # a copy: who draws on it does not draw on the observation
    assert observation["pixels"]["front"].any()


def test_the_state_is_the_contracts(env: KeyframeEnv) -> None:
    observation, _ = env.reset(seed=5)
    pose, gripper = pose_from_vector(observation["agent_pos"][:10])
    np.testing.assert_allclose(pose, env.feedback.tcp_in_base, atol=1e-5)
    assert gripper == pytest.approx(1.0, abs=0.02)
    cloud = observation["point_cloud"]
    assert env.workspace.contains(cloud).all()
    assert len(np.unique(cloud, axis=0)) == len(cloud)
    camera = np.asarray(env.camera_parameters()["extrinsics"])
    ahead = (cloud - camera[:3, 3]) @ camera[:3, 2]
    assert (ahead > 0).all()  # OpenCV axes: z points into the view


def test_an_earlier_observation_is_not_overwritten(env: KeyframeEnv) -> None:
    first, _ = env.reset(seed=6)
    before = digest(first)
    grasp_handle(env)
    assert digest(first) == before


def test_an_episode_is_truncated_and_never_both(env: KeyframeEnv) -> None:
    env.reset(seed=5)
    ends = [env.step(stay(env))[2:4] for _ in range(30)]
    assert ends == [(False, False)] * 29 + [(False, True)]


def test_object_id_chooses_seen_and_unseen_objects(env: KeyframeEnv) -> None:
    for name in ("safe_002", "safe_041"):
        env.reset(seed=5, options={"object_id": name})
        assert env.episode_record()["object_id"] == name


def test_a_refused_reset_leaves_no_episode_and_the_next_works(env: KeyframeEnv) -> None:
    for options in (
        {"object_id": "fridge_001"},
        {"object_id": "door_001"},
        {"object_id": "0:2"},
        {"objectid": "safe_002"},
        {"hidden_overrides": {"lokced": True}},
    ):
        with pytest.raises(ConfigurationError):
            env.reset(seed=5, options=options)
        with pytest.raises(gym.error.ResetNeeded):
            env.step(np.zeros(10, np.float32))
    assert env.observation_space.contains(env.reset(seed=5)[0])


def test_a_reset_leaves_the_callers_garbage_collector_alone(env: KeyframeEnv) -> None:
    env.reset(seed=5)
    assert gc.get_freeze_count() < 1000  # what the interpreter itself freezes
    gc.freeze()
    try:
        frozen = gc.get_freeze_count()
        env.reset(seed=5)
        assert gc.get_freeze_count() >= frozen - 1000
    finally:
        gc.unfreeze()


def test_nothing_runs_before_reset_or_after_close() -> None:
    made = KeyframeEnv("safe", **SMALL)
    for use in (lambda: made.step(np.zeros(10, np.float32)), made.hidden_state, made.episode_record):
        with pytest.raises(gym.error.ResetNeeded):
            use()
    made.close()
    made.close()


# Repeatability ----------------------------------------------------------------------------------------------------

FRESH = """
import json, sys
sys.path.insert(0, {folder!r})
from envs_helpers import SMALL, expert_episode
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
env = KeyframeEnv("safe", max_key_frames=30, **SMALL)
print(json.dumps(expert_episode(env, 11, hidden_overrides={{"locked": True}})[0]))
"""


def test_one_seed_is_one_episode_byte_for_byte(env: KeyframeEnv) -> None:
    """In a simulator that has other episodes behind it, and in a fresh one."""
    other = digest(env.reset(seed=12, options={"hidden_overrides": {"locked": True}})[0])
    grasp_handle(env)
    hashes, phases, _ = expert_episode(env, 11, hidden_overrides={"locked": True})
    assert {Phase.TRY, Phase.UNLOCK, Phase.OPEN} <= set(phases)
    assert other != hashes[0]
    assert in_fresh_process(FRESH.format(folder=str(Path(__file__).parent))) == hashes


def test_unseeded_resets_differ_and_follow_from_the_seed_before(env: KeyframeEnv) -> None:
    runs = []
    for _ in range(2):
        hashes = [digest(env.reset(seed=3)[0])]
        hashes += [digest(env.reset()[0]) for _ in range(2)]
        runs.append(hashes)
    assert runs[0] == runs[1]
    assert len(set(runs[0])) == 3


# Episode log ------------------------------------------------------------------------------------------------------


def test_each_ended_episode_is_logged_once(env: KeyframeEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "logs" / "episodes.jsonl"
    monkeypatch.setattr(env, "_log", EpisodeLog(path))
    expert_episode(env, 5, hidden_overrides={"locked": False})
    env.step(stay(env))  # stepping on after the end is no second episode
    env.reset(seed=6)
    env.step(stay(env))  # left unfinished
    monkeypatch.setattr(env, "options", env.options.changed(max_key_frames=2))
    env.reset(seed=7)
    for _ in range(2):
        env.step(stay(env))
    records = read_log(path)
    assert [(record.seed, record.success) for record in records] == [(5, True), (7, False)]
    assert [record.key_frames for record in records][1] == 2


# What experts and recorders rely on -------------------------------------------------------------------------------


def test_an_episode_goes_on_past_success_and_its_record_does_not(env: KeyframeEnv) -> None:
    expert_episode(env, 5, hidden_overrides={"locked": False})
    record, door = env.episode_record(), env.part_positions()["door"]
    wider = stay(env)
    wider[0] -= 0.03
    wider[9] = 0.0
    for _ in range(2):
        observation, reward, terminated, truncated, info = env.step(wider)
        check_observation(env, observation)
        assert (reward, terminated, truncated, info["is_success"]) == (0.0, True, False, True)
    assert env.episode_record() == record
    assert env.part_positions()["door"] != door


def test_scenes_stay_within_their_split(env: KeyframeEnv) -> None:
    validation = KeyframeEnv("safe", max_key_frames=30, **{**SMALL, "split": "validation"})
    try:
        mapped, _ = validation.reset(seed=5)
        seed = validation.episode_record()["seed"]
        assert split_of(seed) == "validation"
        assert digest(validation.reset(seed=seed)[0]) == digest(mapped)
        assert digest(env.reset(seed=5)[0]) != digest(mapped)
        env.reset()
        assert split_of(env.episode_record()["seed"]) == "test"
        validation.reset(seed=2**31 - 1)
        assert split_of(validation.episode_record()["seed"]) == "validation"
    finally:
        validation.close()


def test_out_of_reach_another_scene_of_the_seed_is_drawn(
    env: KeyframeEnv, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    env.reset(seed=1)
    task = env.episode.task
    real, asked = task.reset, []

    def reset(seed: int, options: dict[str, Any]) -> Any:
        asked.append(seed)
        if len(asked) % 4 in (1, 2):
            raise UnreachableError("No pose within reach.")
        return real(seed=seed, options=options)

    monkeypatch.setattr(task, "reset", reset)
    seen = [digest(env.reset(seed=9, options={"object_id": "safe_003"})[0])]
    assert env.episode_record()["object_id"] == "safe_003"
    assert (asked[0], split_of(asked[2])) == (9, "test")
    assert env.episode_record()["seed"] == asked[2] != 9
    assert "No pose within reach" in caplog.text
    asked.append(0)
    seen.append(digest(env.reset(seed=9, options={"object_id": "safe_003"})[0]))
    assert seen[0] == seen[1]
    monkeypatch.setattr(task, "reset", lambda **_: (_ for _ in ()).throw(UnreachableError("Never.")))
    with pytest.raises(UnreachableError):
        env.reset(seed=9)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(10, np.float32))


def test_an_object_that_no_pose_can_place_is_replaced_as_often_as_it_takes(
    env: KeyframeEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With fixed poses half of the windows are such objects: four in a row are no rare draw."""
    env.reset(seed=1)
    task, asked = env.episode.task, []
    real = task.reset

    def reset(seed: int, options: dict[str, Any]) -> Any:
        asked.append(seed)
        if len(asked) <= 3 * SCENE_TRIES:
            error = UnreachableError("It cannot be placed.")
            error.is_certain = True
            raise error
        return real(seed=seed, options=options)

    monkeypatch.setattr(task, "reset", reset)
    env.reset(seed=9)
    assert len(set(asked)) == len(asked) == 3 * SCENE_TRIES + 1
    assert env.episode_record()["seed"] == asked[-1]


def test_an_environment_tells_its_versions_and_renderer(env: KeyframeEnv) -> None:
    versions = env.software_versions()
    assert {"simulation", "data", "python", "lerobot", "torch", "sapien", "mani_skill", "renderer"} < versions.keys()
    assert versions["renderer"] != "none"
    assert versions == KeyframeEnv("pen").software_versions()
