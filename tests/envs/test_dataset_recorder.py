"""A user's own policy is recorded in the format of `adamanip collect`: complete, durable, and checked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from envs_helpers import stay

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_env_adamanip.dataset_recorder import DatasetRecorder
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim
Envs = Callable[[str], KeyframeEnv]


def short_episode(recorder: DatasetRecorder, env: KeyframeEnv, seed: int, **options: Any) -> list[np.ndarray]:
    """Two key frames of a policy; returns its actions."""
    recorder.reset(seed=seed, options=options)
    actions = []
    for height in (0.0, 0.01):
        actions.append(stay(env) + np.array([0, 0, height, *[0.0] * 6, 0], np.float32))
        network = actions[-1] * np.array([*[1] * 3, *[2] * 6, 1], np.float32)  # its rotation 6D and its gripper
        recorder.step(network + np.array([*[0] * 9, 0.01 * (actions[-1][-1] == 1)], np.float32))
    return actions


def test_a_policys_episodes_become_a_sound_dataset(envs: Envs, tmp_path: Path) -> None:
    env, root = envs("lamp"), tmp_path / "mine"
    recorder = DatasetRecorder(env, root, recorded_by="my policy")
    actions = short_episode(recorder, env, 5, hidden_overrides={"mode": 1})
    observation, _ = recorder.reset(seed=6)
    expert = make_expert("lamp", "adaptive", env.annotations, generator=np.random.default_rng(0))
    result = rollout(recorder, observation, expert)  # the recorder stands for its environment
    assert result.success
    assert recorder.save() == root

    assert check(root).findings == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine"]
    first, second = Dataset(root).descriptions()
    assert (first.success, first.expert, first.hidden_overrides) == (False, "my policy", {"mode": 1})
    assert (second.success, second.seed, second.late) == (True, 6, False)
    assert second.episode_record == env.episode_record()
    rows = open_dataset(root).hf_dataset.with_format("numpy")
    for column in (schema.ACTION, schema.EXECUTED):
        np.testing.assert_allclose(rows[column][:2], actions, atol=1e-6)  # as commanded, as rotations
    last = pose_vector(env.feedback.tcp_in_base, float(rows["action"][-2][-1]))
    np.testing.assert_allclose(rows["action"][-1], last, atol=1e-6)


def test_a_killed_program_goes_on_and_loses_no_ended_episode(envs: Envs, tmp_path: Path) -> None:
    env, root = envs("lamp"), tmp_path / "mine"
    killed = DatasetRecorder(env, root, recorded_by="me")
    short_episode(killed, env, 5)
    killed.reset(seed=6)  # writes the episode before
    killed._stack.close()  # its lock, which the system releases
    with pytest.raises(DatasetError, match=r"(?s)other options.*got: +1 episodes"):
        DatasetRecorder(KeyframeEnv("pen", num_points=128, observe_images=False), root, recorded_by="me")
    recorder = DatasetRecorder(env, root, recorded_by="me")
    assert recorder.episodes == 1
    short_episode(recorder, env, 6)
    recorder.save()
    assert [description.seed for description in Dataset(root).descriptions()] == [5, 6]


def test_a_deleted_episode_makes_no_other_one_vanish(envs: Envs, tmp_path: Path) -> None:
    env, root = envs("lamp"), tmp_path / "mine"
    recorder = DatasetRecorder(env, root, recorded_by="me")
    for seed in range(4):
        short_episode(recorder, env, seed)
    # As the error for a damaged file advises. The fourth episode is not yet written.
    (tmp_path / "mine.recording" / "episodes" / "000001.safetensors").unlink()
    assert recorder.episodes == 3
    recorder.save()
    assert [description.seed for description in Dataset(root).descriptions()] == [0, 2, 3]
    for use in (recorder.save, recorder.reset):
        with pytest.raises(DatasetError, match="recorder is closed"):
            use()


def test_what_cannot_be_recorded_is_refused(envs: Envs, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(DatasetError, match="something at the root"):
        DatasetRecorder(envs("lamp"), tmp_path / "full", recorded_by="me")
    with pytest.raises(ConfigurationError, match="name of a policy"):
        DatasetRecorder(envs("lamp"), tmp_path / "new", recorded_by="a|b")
    with pytest.raises(ConfigurationError, match="Only key-frame environments"):
        DatasetRecorder(gym.make("CartPole-v1"), tmp_path / "new", recorded_by="me")
    recorder = DatasetRecorder(envs("lamp"), tmp_path / "new", recorded_by="me")
    with pytest.raises(DatasetError, match="No episode"):
        recorder.save()
    recorder._stack.close()
