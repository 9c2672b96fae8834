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

from lerobot_adamanip.contract.control import EE_DELTA
from lerobot_adamanip.contract.keyframes import Goal, KeyFrameLabels, KeyFrames, Outcome
from lerobot_adamanip.contract.observation import Observation
from lerobot_adamanip.episode.dense import GRIPPER_MOVES, DenseEnvironment, DenseStep, KeyFrameMotion
from lerobot_adamanip.episode.options import TIME_LIMIT
from lerobot_adamanip.episode.rollout import KeyFrame, KeyframeEnvironment, RolloutResult
from lerobot_adamanip.experts import Belief

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
    actor, rng = correcting.actor, correcting.generator
    actor.reset(correcting.seed)
    belief, success, key_frames, beyond, reason = Belief(), False, 0, 0, TIME_LIMIT
    while key_frames < env.max_key_frames and beyond < BEYOND:
        frames = correcting.take_over(belief=belief, generator=rng)
        goal = next(frames, None)
        frames.close()
        if goal is None:
            reason = "the expert had nothing left to do"
            break
        sent = actor.act(observation, env.task_description)
        if rng.random() < correcting.expert_share:
            sent = goal.action()
            actor.executed(sent)
        before = env.part_positions()
        following, _, _, truncated, info = env.step(sent)
        key_frames, beyond = key_frames + 1, beyond + success
        success = success or bool(info["is_success"])
        on_key_frame(KeyFrame(observation, goal, env.feedback, following, success, env.labels, sent))
        belief = belief.after(env.labels, env.joint_names, before, env.part_positions(), stalled=env.feedback.failed)
        observation = following
        if truncated:
            reason = info.get("limit", TIME_LIMIT)
            break
    return RolloutResult(success, key_frames, "success" if success else reason)


def dense_corrected_rollout(
    env: DenseEnvironment,
    observation: Observation,
    correcting: Correcting,
    on_step: Callable[[DenseStep], None],
) -> RolloutResult:
    """As `corrected_rollout`, at control rate: one segment after the other, driven by the policy or by the expert."""
    run = _DenseCorrections(env, observation, correcting, on_step)
    correcting.actor.reset(correcting.seed)
    segments, beyond, reason = 0, 0, TIME_LIMIT
    while not run.has_ended and beyond < BEYOND:
        frames = correcting.take_over(belief=run.tries.belief, generator=correcting.generator)
        goal = next(frames, None)
        frames.close()
        if goal is None:
            reason = "the expert had nothing left to do"
            break
        segments, beyond = segments + 1, beyond + run.success
        run.drive(goal, is_expert=correcting.generator.random() < correcting.expert_share)
    return RolloutResult(run.success, segments, "success" if run.success else run.limit or reason)


class _DenseCorrections:
    """Runs the segments of an episode.

    Attributes:
        tries: what has been tried so far.
        success: whether the task is done.
        has_ended: whether a limit has ended the episode; ``limit`` is its name.
    """

    def __init__(
        self,
        env: DenseEnvironment,
        observation: Observation,
        correcting: Correcting,
        on_step: Callable[[DenseStep], None],
    ) -> None:
        self._env, self._observation, self._actor, self._on_step = env, observation, correcting.actor, on_step
        self._opening, self._outcome = 1.0, None  # type: tuple[float, Outcome | None]
        self.tries = _TriesSoFar(env)
        self.success, self.has_ended, self.limit = False, False, ""

    def drive(self, goal: Goal, *, is_expert: bool) -> None:
        """Drives a segment: until its key frame has ended, or for `LONGEST_SEGMENT` if the policy drives."""
        env, moves_gripper = self._env, abs(goal.gripper - self._opening) > GRIPPER_MOVES
        is_strained = self._outcome is Outcome.STALLED
        motion = KeyFrameMotion(env, goal, moves_gripper=moves_gripper, strained=is_strained)
        left = round(LONGEST_SEGMENT * env.options.fps)
        self._outcome = None
        while self._outcome is None and not self.has_ended:
            label, sent = motion.action(), self._actor.act(self._observation, env.task_description)
            if is_expert:
                sent = label
                self._actor.executed(sent)
            following, _, _, self.has_ended, info = env.step(sent)
            left -= 1
            self.success = self.success or bool(info["is_success"])
            if self.has_ended:
                self.limit = info.get("limit", TIME_LIMIT)
            is_cut = left <= 0 and not is_expert
            felt = motion.outcome()
            self._outcome = Outcome.TIMEOUT if felt is None and is_cut else felt
            self.tries.after_step(stalled=env.is_blocked)
            self._on_step(
                DenseStep(self._observation, label, goal, self._outcome, following, self.success, env.labels, sent)
            )
            self._observation = following
            self._opening = float(0.5 * (sent[-1] + 1.0) if env.options.action == EE_DELTA else sent[-1])
        if felt is not None:
            self.tries.end(stalled=felt is Outcome.STALLED)


class _TriesSoFar:
    """Follows the tries of an episode at control rate: one is felt when it ends, or when a key frame ends in it."""

    def __init__(self, env: DenseEnvironment) -> None:
        self._env, self.belief = env, Belief()
        self._labels, self._before, self._latest = KeyFrameLabels(), env.part_positions(), env.part_positions()

    def after_step(self, *, stalled: bool) -> None:
        """Follows a step."""
        labels = self._env.labels
        if labels.number != self._labels.number:
            self.end(stalled=stalled)
            self._before = self._latest
        self._labels, self._latest = labels, self._env.part_positions()

    def end(self, *, stalled: bool) -> None:
        """Adds the present try to the belief, if there is one."""
        known = self._env.joint_names, self._before, self._latest
        self.belief = self.belief.after(self._labels, *known, stalled=stalled)
        self._labels = KeyFrameLabels()
