"""With `logged_seeds`, an evaluation's log holds the episodes that LeRobot counts, no surplus of its last batch."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from lerobot.configs.default import EvalConfig
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.scripts import lerobot_eval
from records import record
from torch import nn

from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.evaluation.record import append_record, first_episodes, read_log, split_evaluations
from lerobot_env_adamanip import vector
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig, AdaManipSuiteEnvConfig
from lerobot_env_adamanip.keyframe_env import EpisodeLog, KeyframeEnv


class OneStep(gym.Env[Any, Any]):
    """Logs an episode of one step, as `KeyframeEnv` does; every third succeeds."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    observation_space = gym.spaces.Dict({"point_cloud": gym.spaces.Box(-1, 1, (1, 3), np.float32)})

    def __init__(self, options: EnvironmentOptions) -> None:
        self._log, self._category = EpisodeLog(Path(str(options.episode_log)), options.logged_seeds), options.category

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._seed = seed or 0
        return {"point_cloud": np.zeros((1, 3), np.float32)}, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        success = self._seed % 3 == 0
        episode = record(object_id=f"{self._category}_000", seed=self._seed, success=success)
        self._log.append(episode)
        return {"point_cloud": np.zeros((1, 3), np.float32)}, float(success), True, False, {"is_success": success}


def one_step(env: Any, seeds: list[int], **_: object) -> dict[str, torch.Tensor]:
    """LeRobot's rollout, of one step."""
    env.reset(seed=seeds)
    _, reward, done, _, info = env.step(np.zeros((env.num_envs, 1), np.float32))
    tensors = {"reward": torch.as_tensor(reward), "done": torch.as_tensor(done)}
    return {key: each[:, None] for key, each in {**tensors, "success": torch.as_tensor(info["is_success"])}.items()}


@pytest.mark.parametrize(("episodes", "batch"), [(5, 2), (1, 1), (1, 4), (4, 2), (4, 3), (7, 5), (3, 7), (10, 4)])
@pytest.mark.parametrize("suite", [False, True])
def test_the_log_holds_what_was_asked_for(
    episodes: int, batch: int, suite: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vector, "make_environment", OneStep)
    monkeypatch.setattr(lerobot_eval, "PreTrainedPolicy", nn.Module)
    monkeypatch.setattr(lerobot_eval, "rollout", one_step)
    log = str(tmp_path / "log.jsonl")
    seeds = (1000, 1000 + episodes)
    chosen = AdaManipSuiteEnvConfig(categories="safe,lamp", episode_log=log, logged_seeds=seeds) if suite else None
    pipeline = EvalPipelineConfig(
        env=chosen or AdaManipSafeEnvConfig(episode_log=log, logged_seeds=seeds),
        eval=EvalConfig(n_episodes=episodes, batch_size=batch),
    )
    envs = pipeline.env.create_envs(pipeline.eval.batch_size)
    made = functools.partial(lerobot_eval.eval_policy, env_preprocessor=None, env_postprocessor=None)
    for number, env in enumerate(each[0] for each in envs.values()):
        info = made(
            env, nn.Linear(1, 1), preprocessor=None, postprocessor=None, n_episodes=episodes, start_seed=pipeline.seed
        )
        logged = read_log(Path(log))[number * episodes :]
        assert sorted(each.given_seed for each in logged) == [each["seed"] for each in info["per_episode"]]
        rate = 100 * sum(each.success for each in logged) / episodes
        assert rate == pytest.approx(info["aggregated"]["pc_success"])


def test_left_out_a_whole_batch_is_logged_and_the_first_episodes_are_those_counted(tmp_path: Path) -> None:
    log = EpisodeLog(tmp_path / "log.jsonl")
    for seed in (1001, 1000, 1003, 1002):  # two batches of two, as their episodes end
        log.append(record(seed=seed))
    found = read_log(tmp_path / "log.jsonl")
    assert len(found) == 4
    assert sorted(each.given_seed for each in first_episodes(found, 3)) == [1000, 1001, 1002]


@pytest.mark.parametrize("is_restarted", [False, True], ids=["one process", "new processes"])
def test_each_evaluation_of_a_run_is_a_group_of_its_own(is_restarted: bool, tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    append_record(path, record(seed=1000, run_id="other", evaluation=7))

    def started() -> list[Any]:
        return [KeyframeEnv(episode_log=str(path), run_id="run", observe_images=False)._log for _ in range(2)]

    logs = started()
    for _ in range(3):
        logs = started() if is_restarted else logs
        for seed in range(1000, 1006):
            logs[seed % 2].append(record(seed=seed))
    assert [len(each) for each in split_evaluations(read_log(path))] == [1, 6, 6, 6]
