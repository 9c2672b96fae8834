"""Two environments under LeRobot's own rollout, in one process and in two."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from envs_helpers import SMALL
from lerobot.envs.factory import make_env
from lerobot.scripts.lerobot_eval import rollout
from torch import Tensor, nn

from lerobot_adamanip.evaluation.record import read_log
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim
KEY_FRAMES = 24
OPTIONS = {**SMALL, "objects": "0:4"}


class Replay(nn.Module):
    """A policy that says what it was told to: actions (T, B, 10)."""

    def __init__(self, actions: Tensor) -> None:
        super().__init__()
        self.actions, self.step = actions, 0

    def reset(self) -> None:
        self.step = 0

    def select_action(self, batch: dict[str, Any]) -> Tensor:
        self.step += 1
        return self.actions[min(self.step, len(self.actions)) - 1]


def recorded(env: KeyframeEnv, seed: int) -> list[Any]:
    """The adaptive expert's actions on a seed's episode."""
    env.reset(seed=seed)
    expert = make_expert("safe", "adaptive", env.annotations, generator=np.random.default_rng(0))
    actions, goal = [], next(expert)
    while True:
        actions.append(goal.action())
        if env.step(goal.action())[2]:
            return actions
        goal = expert.send(env.feedback)


@pytest.fixture(scope="module")
def plan() -> tuple[list[int], Tensor]:
    """Seeds of an unlocked and a locked safe, and actions (T, 2, 10) that open both, the first sooner."""
    env, found = KeyframeEnv("safe", max_key_frames=KEY_FRAMES, **OPTIONS), {}
    for seed in range(70, 90):
        env.reset(seed=seed)
        found.setdefault(env.hidden_state()["locked"], seed)
        if len(found) == 2:
            break
    short, long = recorded(env, found[False]), recorded(env, found[True])
    env.close()
    assert len(short) + 5 < len(long) < KEY_FRAMES
    padded = short + [short[0]] * (len(long) - len(short))  # after its end a policy goes on talking
    return [found[False], found[True]], torch.from_numpy(np.stack([padded, long], axis=1))


def run(config: AdaManipSafeEnvConfig, actions: Tensor, seeds: list[int], *, use_async: bool) -> dict[str, Any]:
    vector = make_env(config, n_envs=2, use_async_envs=use_async)["adamanip_safe"][0]
    before, after = config.get_env_processors()
    try:
        first = rollout(vector, Replay(actions), before, after, dict, lambda action: action, seeds, True)
        again = rollout(vector, Replay(actions[:2]), before, after, dict, lambda action: action, seeds[::-1])
    finally:
        vector.close()
    assert not again["success"].any()  # a second rollout starts anew, on frozen environments too
    return dict(first)


@pytest.mark.nightly
@pytest.mark.timeout(290)
def test_one_process_or_two_give_the_same_rollout(plan: tuple[list[int], Tensor], tmp_path: Path) -> None:
    seeds, actions = plan
    results = []
    for use_async in (False, True):
        log = tmp_path / f"{use_async}.jsonl"
        config = AdaManipSafeEnvConfig(episode_length=KEY_FRAMES, episode_log=str(log), **OPTIONS)
        results.append(run(config, actions, seeds, use_async=use_async))
        records = read_log(log)
        assert {(r.seed, r.success, r.locked) for r in records[:2]} == {(seeds[0], True, False), (seeds[1], True, True)}
        # The second rollout repeats two key frames until time is up: one more line for each environment, and no other.
        assert [(r.success, r.key_frames) for r in records[2:]] == [(False, KEY_FRAMES)] * 2
    sync, other = results
    assert set(sync["observation"]) == set(other["observation"])
    for key, value in sync["observation"].items():
        if isinstance(value, Tensor):
            assert torch.equal(value, other["observation"][key]), key
    for key in ("action", "reward", "success", "done"):
        assert torch.equal(sync[key], other[key]), key
