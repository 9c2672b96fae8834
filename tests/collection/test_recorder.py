from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from demos_fake_env import FakeEnv
from demos_helpers import fakes, make_spec

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrameLabels, Outcome, Phase
from lerobot_adamanip.contract.observation import observation_columns
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.episode.rollout import EpisodeRecorder, KeyFrame, rollout
from lerobot_adamanip.util.errors import UnreachableError

PULL = Goal(transform((0.6, 0.0, 0.2)), 0.0, Phase.TRY)
FARTHER = Goal(transform((0.7, 0.0, 0.2)), 0.0, Phase.OPEN)
UNLOCK = Goal(transform((0.3, 0.0, 0.6)), 0.0, Phase.UNLOCK)


def ready(locked: bool) -> tuple[FakeEnv, dict]:
    env: FakeEnv = fakes().environment(make_spec().environment_of("safe"))  # type: ignore[assignment]
    for seed in range(100):
        try:
            observation, _ = env.reset(seed=seed, options={"object_id": "safe_000"})
        except UnreachableError:
            continue
        if env.locked == locked:
            return env, observation
    raise AssertionError("no seed gives such an episode")


def play(*goals: Goal) -> Iterator[Goal]:
    for goal in goals:  # noqa: UP028 (it has to accept what is sent to it)
        yield goal


def test_a_row_pairs_what_was_seen_before_an_action_with_how_it_ended() -> None:
    env, first = ready(locked=True)
    recorder = EpisodeRecorder(env.joints)
    result = rollout(env, first, play(PULL, UNLOCK, PULL), recorder.record)
    columns = recorder.columns()
    assert result.success
    assert result.key_frames == 3
    np.testing.assert_array_equal(columns[schema.STATE][0], first["agent_pos"])
    np.testing.assert_array_equal(columns[schema.ACTION][1], UNLOCK.action())
    outcomes = [Outcome.STALLED, Outcome.REACHED, Outcome.REACHED, Outcome.REACHED]
    assert columns[schema.OUTCOME][:, 0].tolist() == outcomes
    assert columns[schema.PHASE][:, 0].tolist() == [Phase.TRY, Phase.UNLOCK, Phase.TRY, Phase.TRY]
    # What the environment says of each try, on its own row.
    assert columns[schema.TRIED][:, 0].tolist() == [0, -1, 0, -1]
    assert columns[schema.FAILED][:, 0].tolist() == [True, False, False, False]
    assert columns[schema.TRIAL][:, 0].tolist() == [0, 1, 1, 1]
    np.testing.assert_allclose(columns[schema.PROGRESS][:, 0], [0.0, 0.0, 0.3, 0.0], atol=1e-6)
    assert columns[schema.SUCCESS][:, 0].tolist() == [False, False, True, True]
    # Where everything stood when the row was seen: it stalled at 0.3, came back to it, and opened to 0.6.
    np.testing.assert_allclose(columns[schema.JOINTS][:, 0], [0.3, 0.3, 0.3, 0.6], atol=1e-6)
    np.testing.assert_allclose(columns[schema.JOINTS][:, 9], [0.0, 0.0, 0.0, 0.6], atol=1e-6)
    # The state after an action is the next row's: the pull stalled where it began, the unlocking arrived.
    assert columns[schema.STATE][1, 0] == columns[schema.STATE][0, 0]
    np.testing.assert_allclose(columns[schema.STATE][2, :3], UNLOCK.action()[:3])


def test_a_try_that_moves_its_joint_in_a_later_key_frame_has_not_failed() -> None:
    """One try spans the first two key frames and succeeds; the try of the third fails."""
    env, first = ready(locked=False)
    recorder, steps = EpisodeRecorder(env.joints), list[KeyFrame]()
    rollout(env, first, play(PULL, FARTHER, PULL), steps.append, past_success=True)
    labels = [
        KeyFrameLabels(0, True, number=0),
        KeyFrameLabels(0, trial=1, number=0),
        KeyFrameLabels(1, True, number=1),
    ]
    for step, label in zip(steps, labels, strict=True):
        recorder.record(replace(step, labels=label))
    columns = recorder.columns()
    assert columns[schema.FAILED][:, 0].tolist() == [False, False, True, False]
    assert columns[schema.TRIAL][:, 0].tolist() == [0, 0, 0, 1]


def test_a_failed_try_that_goes_on_to_the_end_is_counted_once() -> None:
    env, first = ready(locked=True)
    recorder, steps = EpisodeRecorder(env.joints), list[KeyFrame]()
    rollout(env, first, play(PULL, PULL), steps.append)
    for step, trial in zip(steps, (0, 1), strict=True):
        recorder.record(replace(step, labels=KeyFrameLabels(0, True, trial=trial, number=0)))
    assert recorder.columns()[schema.TRIAL][:, 0].tolist() == [0, 1, 1]


def test_the_last_row_is_the_final_observation_and_stays_in_place() -> None:
    env, first = ready(locked=False)
    recorder, last = EpisodeRecorder(env.joints), []
    rollout(env, first, play(PULL, FARTHER), lambda key_frame: (recorder.record(key_frame), last.append(key_frame)))
    columns = recorder.columns()
    assert columns[schema.DONE][:, 0].tolist() == [False] * (len(last)) + [True]
    np.testing.assert_array_equal(columns[schema.STATE][-1], last[-1].following["agent_pos"])
    np.testing.assert_allclose(columns[schema.ACTION][-1][:3], env.feedback.tcp_in_base[:3, 3])
    assert columns[schema.ACTION][-1][schema.GRIPPER_DIM] == 0.0  # what is held stays held


def test_a_recorder_keeps_what_it_was_given_though_the_environment_reuses_its_buffers() -> None:
    _, observation = ready(locked=False)
    seen = observation_columns(observation)
    before = {key: value.copy() for key, value in seen.items()}
    for value in (observation["agent_pos"], observation["effort"], observation["point_cloud"]):
        value[...] = 7.0
    observation["pixels"]["front"][...] = 7
    for key, value in seen.items():
        np.testing.assert_array_equal(value, before[key])
    assert seen[schema.STATE].max() < 7.0


@pytest.mark.parametrize(
    ("locked", "goals", "past", "key_frames", "reason"),
    [
        (False, [PULL, FARTHER, FARTHER], False, 1, "success"),
        (False, [PULL, FARTHER, FARTHER], True, 3, "success"),  # a demonstration goes on until its expert ends
        (True, [PULL], False, 1, "the expert ended without success"),
        (True, [PULL] * 100, True, FakeEnv.max_key_frames, "time limit"),
    ],
)
def test_a_rollout_ends_with_success_its_expert_or_its_time(
    locked: bool, goals: list[Goal], past: bool, key_frames: int, reason: str
) -> None:
    env, first = ready(locked=locked)
    recorder, heard, closed = EpisodeRecorder(env.joints), list[Feedback](), list[bool]()

    def expert() -> Iterator[Goal]:
        try:
            for goal in goals:
                heard.append((yield goal))
        finally:
            closed.append(True)

    result = rollout(env, first, expert(), recorder.record, past_success=past)
    assert (result.success, result.key_frames, result.reason) == (not locked, key_frames, reason)
    assert len(recorder.columns()[schema.ACTION]) == key_frames + 1
    assert closed == [True]
    assert all(feedback.outcome is (Outcome.STALLED if locked else Outcome.REACHED) for feedback in heard)
