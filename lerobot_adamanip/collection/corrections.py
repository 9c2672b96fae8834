"""Corrections: a policy acts, and an expert labels every visited state with its own action.

DAgger (Ross et al. 2011). At each key frame either the policy or the expert acts. The expert can take over in any state
and knows the feedback of all tries so far. Its action becomes the row's ``action``. The executed action is the column
``complementary_info.executed``, which forms the policy's history. So the data contains the policy's mistakes, and how
to recover from them.

At control rate the expert plans a key frame from the present state, and labels the steps of this *segment* with the
actions of its path. Planned anew at each step, it would always label the slow start of a path, and feel no stall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.collection.tries_so_far import DenseTries, KeyFrameTries, TriesSoFar, followed
from lerobot_adamanip.contract.keyframes import Goal, KeyFrames
from lerobot_adamanip.contract.observation import Observation
from lerobot_adamanip.episode.dense import DenseEnvironment, DenseRun, DenseStep
from lerobot_adamanip.episode.options import TIME_LIMIT
from lerobot_adamanip.episode.rollout import KeyFrame, KeyframeEnvironment, KeyFrameRun, RolloutResult, Run, result_of

Action = NDArray[np.float32]
BEYOND = 1
"""Key frames after success, about as many as in demonstrations."""


class Actor(Protocol):
    """A policy that acts in one environment."""

    def reset(self, seed: int) -> None:
        """Starts an episode; all random numbers follow from the seed."""

    def act(self, observation: Observation, instruction: str) -> Action:
        """Returns the action (A,) for an observation."""

    def executed(self, action: Action) -> None:
        """Replaces the latest action in the policy's history by the executed (A,) action."""


ActorFactory = Callable[[], Actor]
"""Loads an actor. Must be a module-level function or a `functools.partial` of one, to be sent to workers."""


TakeOver = Callable[..., KeyFrames]
"""Creates an expert from ``belief`` and ``generator`` that takes over in the environment's present state."""


LONGEST_SEGMENT = 1.0
"""Longest segment that a policy drives [s]; then the expert plans again."""


@dataclass(frozen=True)
class Correcting:
    """Policy and expert of an episode.

    Attributes:
        actor: the policy; reset by `corrected_rollout`.
        take_over: creates the expert that labels, and sometimes acts.
        expert_share: probability that the expert acts at a key frame, or in a segment.
        seed: seed of the episode.
        generator: random numbers for the expert's labels, and for the choice between policy and expert.
    """

    actor: Actor
    take_over: TakeOver
    expert_share: float
    seed: int
    generator: np.random.Generator


def corrected_rollout(
    env: KeyframeEnvironment,
    observation: Observation,
    correcting: Correcting,
    on_key_frame: Callable[[KeyFrame], None],
) -> RolloutResult:
    """Runs a policy with expert corrections on a freshly reset environment, until shortly after success.

    Args:
        env: environment after a reset.
        observation: observation from the reset.
        correcting: policy and expert.
        on_key_frame: called with every key frame.
    """
    run, tries, actor = (
        KeyFrameRun(env, observation, on_key_frame, past_success=True),
        KeyFrameTries(env),
        correcting.actor,
    )

    def drive(goal: Goal) -> None:
        sent = actor.act(run.observation, env.task_description)
        if correcting.generator.random() < correcting.expert_share:
            sent = goal.action()
            actor.executed(sent)
        tries.end(run.drive(goal, sent).outcome)

    return _corrected(run, tries, correcting, drive)


def dense_corrected_rollout(
    env: DenseEnvironment,
    observation: Observation,
    correcting: Correcting,
    on_step: Callable[[DenseStep], None],
) -> RolloutResult:
    """As `corrected_rollout`, at control rate: one segment after the other, driven by the policy or by the expert.

    A segment is a key frame, of `LONGEST_SEGMENT` at most if the policy drives.
    """
    tries, actor = DenseTries(env), correcting.actor
    run = DenseRun(env, observation, followed(tries, on_step), past_success=True)

    def acted(label: Action) -> Action:
        return actor.act(run.observation, env.task_description)

    def taught(label: Action) -> Action:
        acted(label)
        actor.executed(label)
        return label

    def drive(goal: Goal) -> None:
        is_expert = correcting.generator.random() < correcting.expert_share
        most = None if is_expert else round(LONGEST_SEGMENT * env.options.fps)
        felt = run.follow(goal, taught if is_expert else acted, most_steps=most)
        if felt is not None:
            tries.end(felt)

    return _corrected(run, tries, correcting, drive)


def _corrected(run: Run, tries: TriesSoFar, correcting: Correcting, drive: Callable[[Goal], None]) -> RolloutResult:
    """Plans a goal in each state, and drives towards it, until shortly after success."""
    correcting.actor.reset(correcting.seed)
    beyond, reason = 0, TIME_LIMIT
    while not run.has_ended and beyond < BEYOND:
        frames = correcting.take_over(belief=tries.belief, generator=correcting.generator)
        goal = next(frames, None)
        frames.close()
        if goal is None:
            reason = "the expert had nothing left to do"
            break
        beyond += run.success
        drive(goal)
    return result_of(run, reason)
