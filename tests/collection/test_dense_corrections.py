"""Corrections at control rate: segments of the expert's key frames, labels for every step, and who drives them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.collection.corrections import Correcting, dense_corrected_rollout
from lerobot_adamanip.contract import schema
from lerobot_adamanip.episode.dense import DenseRecorder
from lerobot_adamanip.experts import make_expert

pytestmark = pytest.mark.sim
CATEGORY, SEED = "bottle", 0


class Wavering:
    """A policy that sends small random motions."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def reset(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)

    def act(self, observation: Any, instruction: str) -> np.ndarray:
        assert instruction
        motion = self.generator.normal(0.0, 0.1, 6)
        return np.append(motion, 1.0 if self.generator.random() < 0.3 else -1.0).astype(np.float32)

    def executed(self, action: np.ndarray) -> None:
        self.told.append(action)


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    from lerobot_env_adamanip.dense_env import DenseEnv

    environment = DenseEnv(CATEGORY, observe_images=False, max_steps=200)
    yield environment
    environment.close()


def corrected(env: Any, share: float, seed: int = SEED) -> tuple[Any, dict[str, np.ndarray], Wavering, list[Any]]:
    """Result, columns, policy, and what the expert believed at each segment."""
    observation, _ = env.reset(seed=seed)
    recorder, actor, beliefs = DenseRecorder(env), Wavering(), []

    def take_over(belief: Any, generator: np.random.Generator) -> Any:
        beliefs.append(belief)
        known = {"positions": env.part_positions(), "feedback": env.feedback, "belief": belief}
        return make_expert(CATEGORY, "adaptive", env.annotations, generator=generator, **known)

    correcting = Correcting(actor, take_over, share, seed, np.random.default_rng(seed))
    result = dense_corrected_rollout(env, observation, correcting, recorder.record)
    return result, recorder.columns(), actor, beliefs


def test_an_expert_that_plans_anew_at_each_key_frame_opens_it(env: Any) -> None:
    for seed in range(3):
        result, columns, actor, beliefs = corrected(env, 1.0, seed)
        assert result.success
        np.testing.assert_array_equal(columns[schema.ACTION], columns[schema.EXECUTED])
        assert len(actor.told) == len(columns[schema.ACTION]) - 1
        tries = {tuple(each[:3]) for each in env.episode_record()["try_sequence"]}
        felt = {(env.joint_names.index(each.joint), each.sign, each.failed) for each in beliefs[-1].tries}
        assert {one for one in tries if one[2]} <= felt, "the expert knows what has failed"


def test_a_policy_that_drives_is_labelled_in_segments_of_a_second(env: Any) -> None:
    result, columns, actor, beliefs = corrected(env, 0.0)
    assert not result.success
    assert actor.told == []
    labels, sent = columns[schema.ACTION][:-1], columns[schema.EXECUTED][:-1]
    assert not (labels == sent).all(axis=1).any()
    assert np.abs(labels).max() <= 1.0
    ends = np.flatnonzero(columns[schema.OUTCOME][:-1, 0] != schema.GOES_ON)
    assert len(beliefs) in (len(ends), len(ends) + 1)  # the time limit may cut the last one
    assert np.diff(ends).max() <= env.options.fps
    goals = columns[schema.KEY_FRAME]
    for first, last in zip([0, *ends[:-1] + 1], ends, strict=True):
        np.testing.assert_array_equal(goals[first : last + 1], np.broadcast_to(goals[first], (last + 1 - first, 10)))


def test_episodes_are_the_same_again_and_replay(env: Any) -> None:
    _, first, *_ = corrected(env, 0.5)
    _, second, *_ = corrected(env, 0.5)
    for key, column in first.items():
        np.testing.assert_array_equal(column, second[key])
    assert 0.1 < (first[schema.ACTION] == first[schema.EXECUTED]).all(axis=1).mean() < 0.9
    observation, _ = env.reset(seed=SEED)
    for row, action in enumerate(first[schema.EXECUTED][:-1]):
        np.testing.assert_array_equal(observation["agent_pos"], first[schema.STATE][row])
        observation = env.step(action)[0]
