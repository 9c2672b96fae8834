"""Corrections: a policy acts, and an expert labels every visited state with its own action.

DAgger (Ross et al. 2011). At each key frame either the policy or the expert acts. The expert can take over in any state
and knows the feedback of all tries so far. Its action becomes the row's ``action``. The executed action is the column
``complementary_info.executed``, which forms the policy's history. So the data contains the policy's mistakes, and how
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
        """Returns the (10,) action for an observation."""

    def executed(self, action: Action) -> None:
        """Replaces the latest action in the policy's history by the executed (10,) action."""


ActorFactory = Callable[[], Actor]
"""Loads an actor. Must be a module-level function or a `functools.partial` of one, to be sent to workers."""


TakeOver = Callable[..., KeyFrames]
"""Creates an expert from ``belief`` and ``generator`` that takes over in the environment's present state."""


@dataclass(frozen=True)
class Correcting:
    """Policy and expert of an episode.

    Attributes:
        actor: the policy; reset by `corrected_rollout`.
        take_over: creates the expert that labels, and sometimes acts.
        expert_share: probability that the expert acts at a key frame.
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
