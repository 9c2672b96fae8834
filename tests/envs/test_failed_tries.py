"""``max_failed_tries``: an episode ends with the failed try that is one too many, and nothing else changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from envs_helpers import SMALL, stay

from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.contract.rotations import pose_vector, straight_path
from lerobot_adamanip.episode.options import BEST, TIME_LIMIT, TOO_MANY_TRIES
from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.episode.tries import Try
from lerobot_adamanip.evaluation.metrics import within_best_tries
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.experts import KeyFrames, make_expert
from lerobot_adamanip.experts.lamp import MOTIONS, _attempt
from lerobot_adamanip.experts.primitives import Hand
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim
MODES = range(len(MOTIONS))


@pytest.fixture(scope="module")
def lamp() -> Iterator[Callable[[int | str | None], KeyframeEnv]]:
    """Makes environments of one lamp that share a simulator."""
    made = KeyframeEnv("lamp", **{**SMALL, "objects": "0:1", "observe_images": False})

    def limited(most: int | str | None) -> KeyframeEnv:
        made.options = made.options.changed(max_failed_tries=most)
        return made

    yield limited
    made.close()


def trying(env: KeyframeEnv, modes: list[int]) -> KeyFrames:
    """Holds the knob and tries these motions, whatever comes of it."""
    hand, knob = Hand(np.random.default_rng(0), settles={"button": 0.0}), env.annotations["knob"]
    yield from hand.grasp(knob)
    for mode in modes:
        if (yield from _attempt(hand, knob, mode)):
            return


def outcome(env: KeyframeEnv, hidden: int, modes: list[int]) -> tuple[bool, Any]:
    observation, _ = env.reset(seed=3, options={"hidden_overrides": {"mode": hidden}})
    result = rollout(env, observation, trying(env, modes))
    record = EpisodeRecord.from_json(env.episode_record())
    assert record.success == result.success
    assert result.success or result.reason == TOO_MANY_TRIES
    return record.success, record


def test_a_policy_that_repeats_and_the_best_one_have_what_they_must(lamp: Any) -> None:
    """With three modes, repeating opens one of three; trying each once opens all, with two failures at most."""
    env = lamp(BEST)
    for hidden in MODES:
        success, record = outcome(env, hidden, [0] * 9)
        assert success == (hidden == 0)
        assert record.failed_tries == (0 if success else 3), "it ends with the one that is too many"
        success, record = outcome(env, hidden, list(MODES))
        assert success
        assert record.failed_tries == hidden


def test_it_is_what_counting_says_of_the_whole_episode(lamp: Any) -> None:
    for hidden, modes in ((0, [1, 2, 0]), (2, [1, 1, 0, 2]), (1, [0, 0, 0, 1])):
        success, whole = outcome(lamp(None), hidden, modes)
        assert success
        for most in (0, 2):
            limited, record = outcome(lamp(most), hidden, modes)
            assert limited == (whole.failed_tries <= most)
            assert record.try_sequence == whole.try_sequence[: len(record.try_sequence)]
        assert outcome(lamp(BEST), hidden, modes)[0] == within_best_tries(whole)


def test_a_try_that_goes_on_is_not_counted() -> None:
    """An unlocked safe that is pulled in small key frames: the first one moves the door by less than a motion."""
    made = KeyframeEnv(
        "safe", **{**SMALL, "objects": "0:1", "observe_images": False, "max_failed_tries": 0, "split": "validation"}
    )
    made.reset(seed=3, options={"hidden_overrides": {"locked": False}})
    expert = make_expert("safe", "adaptive", made.annotations, generator=np.random.default_rng(0))
    goal = next(expert)
    while goal.phase is not Phase.TRY:
        made.step(goal.action())
        goal = expert.send(made.feedback)
    path = straight_path(made.feedback.tcp_in_base, goal.tcp_in_base, np.arange(1, 13) / 12)
    unfinished = 0
    for pose in path:
        _, _, terminated, truncated, info = made.step(pose_vector(pose, 0.0))
        unfinished += made.labels.failed
        assert not truncated, info["limit"]
        if terminated:
            break
    assert unfinished, "no key frame has moved the door by less than a motion"
    made.close()


def test_what_is_done_after_the_limit_changes_nothing(lamp: Any) -> None:
    env = lamp(0)
    env.reset(seed=3, options={"hidden_overrides": {"mode": 0}})
    frames = trying(env, [1, 0])
    goal, ended = next(frames), False
    for _ in range(12):
        _, reward, terminated, truncated, info = env.step(goal.action())
        ended = ended or truncated
        assert (truncated, terminated, reward, info["is_success"]) == (ended, False, 0.0, False)
        try:
            goal = frames.send(env.feedback)
        except StopIteration:
            break
    assert ended
    assert not EpisodeRecord.from_json(env.episode_record()).success


def test_a_late_start_that_runs_out_of_time_says_so() -> None:
    env = KeyframeEnv("lamp", **{**SMALL, "objects": "0:1", "observe_images": False, "max_key_frames": 4})
    env.reset(seed=3)
    for _ in range(2):
        env.drive(pose_vector(env.feedback.tcp_in_base, 1.0))
    result = rollout(env, env.observe(), trying(env, [1, 1, 1, 1]))
    assert (result.success, result.key_frames, result.reason) == (False, 2, TIME_LIMIT)
    env.close()


@pytest.mark.parametrize(
    ("fails", "limit"), [((True,), TOO_MANY_TRIES), ((False, True), ""), ((True, False), TOO_MANY_TRIES)]
)
def test_a_pull_that_stalls_at_a_part_that_has_given_way_ends_nothing(
    lamp: Any, fails: tuple[bool, ...], limit: str
) -> None:
    env = lamp(0)
    env.reset(seed=3)
    env._task.simulation.tries.tries = [Try(0, 1, failed=each) for each in fails]
    *_, info = env.step(stay(env))
    assert info["limit"] == limit
    assert bool(limit) == (EpisodeRecord.from_json(env.episode_record()).failed_tries > 0)
