"""Rules with several locks in the simulator, scenes that are repeated, and hints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from envs_helpers import SMALL, at_once_or_at_night

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.evaluation.record import read_log
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip import keyframe_env
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.vector import make_vector_env

HARDEST: dict[str, dict[str, Any]] = {
    "row": {"direction": 1, "second_pulls": False, "third_pulls": False},
    "changing": {"direction": 1, "relocks": True, "later_direction": -1},
}
"""Hidden states that need every motion of their rules."""


def play(env: KeyframeEnv, seed: int, kind: str = "adaptive", **hidden: Any) -> Any:
    """Lets an expert run an episode; returns its record."""
    options = {"hidden_overrides": hidden} if hidden else {}
    observation, _ = env.reset(seed=seed, options=options)
    expert = make_expert(
        env.category,
        kind,
        env.annotations,
        generator=np.random.default_rng(seed),
        hidden=env.hidden_state() if kind == "static" else None,
        strategy="to_stop",
        mechanism_rules=env.options.mechanism_rules,
    )
    rollout(env, observation, expert)
    return env.episode.record()


@pytest.mark.sim
@at_once_or_at_night("rules", HARDEST, ("row", "changing"))
def test_the_hardest_hidden_state_of_each_rule_opens_at_a_bottle(rules: str) -> None:
    env = KeyframeEnv("bottle", mechanism_rules=rules, max_failed_tries="best", observe_images=False, **SMALL)
    try:
        record = play(env, 7, **HARDEST[rules])
    finally:
        env.close()
    assert record.success
    assert record.failed_tries <= record.max_failed_tries == 2
    joints = [joint for joint, _, failed in record.try_sequence if not failed]
    assert joints.count(1) >= 2, "the key is moved twice at least"
    if rules == "changing":
        assert (0, 1, True) in record.try_sequence, "a pull shuts the lock"


@pytest.mark.sim
def test_a_scene_is_repeated_with_its_hidden_state_and_says_its_hint(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    env = KeyframeEnv(
        "door", repeats=2, hints=1.0, observe_images=False, episode_log=str(log), max_key_frames=1, **SMALL
    )
    texts, starts = [], []
    try:
        for seed in (40, 41, 42, 50, 51):
            observation, _ = env.reset(seed=seed)
            starts.append(observation["point_cloud"].tobytes())
            texts.append((env.task, env.task_description, env.hidden_state()["direction"]))
            env.drive(np.array([0.5, 0.0, 0.5, 1, 0, 0, 0, 1, 0, 1], np.float32))
    finally:
        env.close()
    assert starts[0] == starts[1] != starts[2]
    assert starts[3] == starts[4]
    records = read_log(log)
    assert [record.repeat for record in records] == [0, 1, 0, 0, 1]
    assert [record.given_seed for record in records] == [40, 41, 42, 50, 51]
    assert records[0].seed == records[1].seed
    assert records[0].identity != records[1].identity
    assert {record.provenance.evaluation for record in records} == {0}, "a repeat is no second evaluation"
    for task, description, direction in texts:
        assert task == description == f"Open the door. It turns {'right' if direction > 0 else 'left'}."


class Scenes(KeyframeEnv):
    """Notes the scene and the repeat of each reset, without a simulator."""

    def _load_scene(self, task: Any, seed: int, chosen: dict[str, Any]) -> int:
        return seed

    def _start_episode(self, task: Any) -> None:
        self.played = self._seeds["seed"], self._seeds["repeat"]

    def observe(self) -> dict[str, Any]:
        return {}

    def _info(self) -> dict[str, Any]:
        return {}


def test_resets_without_a_seed_repeat_the_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `gymnasium.make_vec` resets each environment when its episode has ended."""
    monkeypatch.setattr(keyframe_env, "make_task", lambda *_, **__: object())
    env, other = Scenes("door", repeats=3), Scenes("door")
    played, single = [], []
    for seed in (1_000_040, None, None, None, None, 1_000_050, None):
        for each, seen in ((env, played), (other, single)):
            each.reset(seed=seed)
            seen.append(each.played)
    first, second = played[0][0], played[3][0]
    assert first == 1_000_040 != second
    assert played == [(first, 0), (first, 1), (first, 2), (second, 0), (second, 1), (1_000_050, 0), (1_000_050, 1)]
    assert len({scene for scene, _ in single}) == 7


def test_repeats_need_one_environment() -> None:
    env = KeyframeEnv("door", repeats=3)
    with pytest.raises(ConfigurationError, match="batch_size=1"):
        make_vector_env(env.options, 2, False, {})
    assert env.task == CATEGORIES["door"].instruction
