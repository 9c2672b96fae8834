"""Corrections: a policy drives, and an expert labels every state with its own action.

DAgger (Ross et al. 2011). At each key frame either the policy or the expert acts. The expert takes over from any state,
with a belief from all tries so far; its action becomes the row's ``action``. The action that was sent is the column
``complementary_info.executed``, from which a policy's history is made. So the data has the policy's mistakes, and how
to recover from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import KeyFrames
from lerobot_adamanip.contract.observation import Observation
from lerobot_adamanip.episode.rollout import KeyFrame, KeyframeEnvironment, RolloutResult
from lerobot_adamanip.experts import Belief

Action = NDArray[np.float32]
BEYOND = 1
"""Key frames after success, about as many as in demonstrations."""
STREAM = 3
"""Makes these draws differ from others with the episode's seed."""


class Actor(Protocol):
    """A policy acting in one environment."""

    def reset(self, seed: int) -> None:
        """Begins an episode; random draws follow from the seed."""

    def act(self, observation: Observation, instruction: str) -> Action:
        """Returns its (10,) action."""

    def executed(self, action: Action) -> None:
        """Replaces its latest action, in its memory, by the (10,) action that was sent instead."""


ActorFactory = Callable[[], Actor]
"""Loads an actor. Must be a module-level function or a `functools.partial` of one, to be sent to workers."""


TakeOver = Callable[..., KeyFrames]
"""Takes ``belief`` and ``generator``; returns an expert that takes over from the environment's present state."""


@dataclass(frozen=True)
class Correcting:
    """Policy and expert of an episode.

    Attributes:
        actor: the policy; reset by `corrected_rollout`.
        take_over: returns the expert that labels, and sometimes acts.
        expert_share: probability that the expert acts at a key frame.
        seed: seed of the episode.
    """

    actor: Actor
    take_over: TakeOver
    expert_share: float
    seed: int


def corrected_rollout(
    env: KeyframeEnvironment,
    observation: Observation,
    correcting: Correcting,
    on_key_frame: Callable[[KeyFrame], None],
) -> RolloutResult:
    """Runs a policy, corrected by an expert, in a freshly reset environment until just after success.

    Args:
        env: environment after a reset.
        observation: observation from the reset.
        correcting: policy and expert.
        on_key_frame: called with every key frame.
    """
    actor, rng = correcting.actor, np.random.default_rng([correcting.seed, STREAM])
    actor.reset(correcting.seed)
    belief, success, key_frames, beyond, reason = Belief(), False, 0, 0, "time limit"
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
        key_frames += 1
        beyond += success
        success = success or bool(info["is_success"])
        on_key_frame(KeyFrame(observation, goal, env.feedback, following, success, env.labels, sent))
        belief = belief.after(env.labels, env.joint_names, before, env.part_positions())
        observation = following
        if truncated:
            break
    return RolloutResult(success, key_frames, "success" if success else reason)
