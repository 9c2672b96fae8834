"""Demonstrations with mistakes: what is sent differs in a share of the key frames, and the label stays the expert's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import demos_fake_env
import numpy as np
import pytest
from demos_helpers import fakes, make_spec, patiently, same_bytes

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.mistakes import (
    EARLY_PULL_M,
    MistakenExpert,
    Mistakes,
    mistaken_rollout,
)
from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.collection.tries_so_far import DenseTries, KeyFrameTries, followed
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import CONTROLS, DENSE
from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrameLabels, Outcome, Phase
from lerobot_adamanip.contract.rotations import pose_from_vector, rotation_about, transform
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.manifest import Manifest, read_manifest
from lerobot_adamanip.episode.dense import DenseRun
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.rollout import KeyFrameRun
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.make_environment import make_environment

HERE = transform((0.5, 0.0, 0.3), rotation_about((1.0, 0.0, 0.0), np.pi))
HELD = Feedback(HERE, 0.3, Outcome.REACHED)


def drawn(goal: Goal, feedback: Feedback = HELD, *, failed: Any = None, draws: int = 200) -> np.ndarray:
    """Returns many mistakes (N, 10) in place of a goal."""
    mistakes = Mistakes(0.999999, np.random.default_rng(0))
    if failed is not None:
        mistakes.after(HERE, failed, KeyFrameLabels(0, True))
    return np.stack([mistake for _ in range(draws) if (mistake := mistakes.draw(goal, feedback)) is not None])


def motion(action: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.inv(HERE) @ pose_from_vector(action)[0])


def test_a_held_part_is_let_go_moved_the_wrong_way_or_not_far_enough() -> None:
    pull = Goal(HERE @ transform((0.0, 0.0, -0.06)), 0.0, Phase.TRY)
    mistakes = drawn(pull)
    lets_go = mistakes[:, schema.GRIPPER_DIM] > 0.5
    ways = np.array([motion(action)[2, 3] for action in mistakes])
    assert lets_go.any()
    assert np.allclose(ways[lets_go], 0.0, atol=1e-6)
    assert np.isclose(ways, 0.06, atol=1e-6).any()
    short = ways[~lets_go & (ways < 0)]
    assert ((short > -0.06 * 0.71) & (short < -0.06 * 0.29)).all()
    assert len(short)


def test_a_failed_try_is_repeated_and_a_turn_becomes_a_pull() -> None:
    turn = Goal(HERE @ transform(rotation=rotation_about((0.0, 0.0, 1.0), 0.5)), 0.0, Phase.UNLOCK)
    failed = HERE @ transform((0.0, 0.03, 0.0))
    ways = np.stack([motion(action)[:3, 3] for action in drawn(turn, failed=failed)])
    assert np.isclose(ways, (0.0, 0.03, 0.0), atol=1e-6).all(axis=1).any()
    assert np.isclose(ways, (0.0, 0.0, -EARLY_PULL_M), atol=1e-6).all(axis=1).any()
    ways = np.stack([motion(action)[:3, 3] for action in drawn(turn)])
    assert not np.isclose(ways, (0.0, 0.03, 0.0), atol=1e-6).all(axis=1).any()


def test_an_approaching_hand_stops_short_or_closes_on_nothing() -> None:
    goal = Goal(HERE @ transform((0.0, 0.0, 0.1)), 1.0, Phase.APPROACH)
    mistakes = drawn(goal, Feedback(HERE, 1.0))
    ways, closes = np.stack([motion(action)[:3, 3] for action in mistakes]), mistakes[:, schema.GRIPPER_DIM] == 0.0
    assert ((ways[:, 2] > 0.029) & (ways[:, 2] < 0.071))[~closes].all()
    np.testing.assert_allclose(ways[closes], 0.0, atol=1e-6)
    assert 0.4 < closes.mean() < 0.6
    for releases in (Goal(goal.tcp_in_base, 1.0, Phase.RELEASE), Goal(goal.tcp_in_base, 0.0, Phase.GRASP)):
        ways = np.array([motion(action)[2, 3] for action in drawn(releases, Feedback(HERE, 1.0))])
        assert (ways > 0.029).all()


def test_the_share_is_the_share() -> None:
    mistakes = Mistakes(0.3, np.random.default_rng(0))
    goal = Goal(HERE @ transform((0.0, 0.0, -0.1)), 1.0, Phase.RELEASE)
    drawn = [mistakes.draw(goal, HELD) for _ in range(2000)]
    assert 0.25 < np.mean([action is not None for action in drawn]) < 0.35
    assert all(np.abs(action - goal.action()).max() > 0.02 for action in drawn if action is not None)


def spec(**changes: Any) -> CollectionSpec:
    return make_spec(**{"mistakes": 0.4, "observe_images": False, "late_starts": 0.0, **changes})


@pytest.mark.usefixtures("in_process")
def test_rows_keep_the_experts_answer_and_replay_what_was_sent(tmp_path: Path) -> None:
    roots = [tmp_path / name / "demos" for name in ("one", "two")]
    for root in roots:
        collect(root, spec(), fakes(), patiently())
    same_bytes(*roots)
    dataset = Dataset(roots[0])
    assert dataset.table["success"].to_pylist() == [True] * 6
    assert read_manifest(roots[0] / "meta" / "collection.json").spec.mistakes == 0.4
    sent, answers = (
        np.concatenate([dataset.columns(episode)[key] for episode in dataset.episodes])
        for key in (schema.EXECUTED, schema.ACTION)
    )
    assert 0.1 < (sent != answers).any(axis=1).mean() < 0.6
    for episode in range(len(dataset)):
        assert replay(roots[0], episode, demos_fake_env.make_env).agrees(0.0)


def test_without_mistakes_the_manifest_is_that_of_before() -> None:
    assert "mistakes" not in Manifest(make_spec()).to_json()["collection"]
    assert Manifest(spec()).to_json()["collection"]["mistakes"] == 0.4


@pytest.mark.parametrize("wrong", [{"mistakes": 1.0}, {"mistakes": -0.1}, {"expert": "static"}, {"policy": "a" * 32}])
def test_mistakes_that_cannot_be_made_are_refused(wrong: dict[str, Any], refuses: Any) -> None:
    refuses(ConfigurationError, lambda: spec(**wrong))


@pytest.mark.sim
@pytest.mark.parametrize("control", CONTROLS)
def test_the_expert_goes_on_from_its_mistakes(control: str) -> None:
    options = EnvironmentOptions("microwave", num_points=64, observe_images=False, split="train", control=control)
    env: Any = make_environment(options)
    succeeded, failed = 0, 0
    try:
        for seed in range(4):
            observation, _ = env.reset(seed=seed, options={"hidden_overrides": {"locked": True}})
            rng, frames = np.random.default_rng(seed), list[Any]()

            def expert(belief: Any = None, generator: Any = None, start: int = seed) -> Any:
                known = {} if belief is None else {"belief": belief}
                state = {} if belief is None else {"positions": env.part_positions(), "feedback": env.feedback}
                generator = np.random.default_rng(start) if generator is None else generator
                return make_expert("microwave", "adaptive", env.annotations, generator=generator, **known, **state)

            driver = MistakenExpert(expert(), expert, Mistakes(0.25, rng), rng)
            if control == DENSE:
                tries: Any = DenseTries(env)
                run: Any = DenseRun(env, observation, followed(tries, frames.append), past_success=True)
            else:
                tries, run = KeyFrameTries(env), KeyFrameRun(env, observation, frames.append, past_success=True)
            result = mistaken_rollout(run, tries, driver)
            succeeded += result.success
            failed += sum(fails for *_, fails in env.episode_record()["try_sequence"])
            assert any(frame.executed is not None for frame in frames)
            done = [frame.success and (control != DENSE or frame.outcome is not None) for frame in frames]
            after = done.index(True) + 1 if result.success else len(frames)
            assert all(frame.executed is None for frame in frames[after:])
            assert not run.has_ended, "it ends where the expert ends"
    finally:
        env.close()
    assert succeeded >= 3
    assert failed >= 4
