"""Corrections: a policy drives, and every state that it gets into is labelled with what an expert would do from there.

DAgger (Ross et al. 2011). Key frame by key frame either the policy or the expert acts; the expert, which takes over
from any state and believes what has been felt so far, in any hand, says each time what it would do. That becomes the
row's ``action``; what was really sent is the column ``complementary_info.executed``, of which a policy's history is
made. So a policy sees its own mistakes, and how to go on from them.
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
"""Key frames past success, about as many as demonstrations have."""
STREAM = 3
"""Tells these draws from any other that starts from the episode's seed."""


class Actor(Protocol):
    """A policy at work in one environment."""

    def reset(self, seed: int) -> None:
        """Begins an episode; whatever it leaves to chance follows from the seed."""

    def act(self, observation: Observation, instruction: str) -> Action:
        """Returns the (10,) action that it would take."""

    def executed(self, action: Action) -> None:
        """Is told that another (10,) action was taken instead of its latest one."""


ActorFactory = Callable[[], Actor]
"""Loads an actor. A function of a module, or a `functools.partial` of one: workers get it from the parent."""


class TakeOver(Protocol):
    """Makes experts that take over from the environment's present state."""

    def __call__(self, *, belief: Belief, generator: np.random.Generator) -> KeyFrames:
        """Returns one that believes what has been tried; ``generator`` decides what it leaves to chance."""


@dataclass(frozen=True)
class Correcting:
    """Who acts in an episode.

    Attributes:
        actor: the policy; reset by `corrected_rollout`.
        take_over: returns the expert that labels, and now and then acts.
        expert_share: probability that a key frame is the expert's.
        seed: of the episode.
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
    """Lets a policy act on a freshly reset environment, corrected by an expert, until just past success.

    Args:
        env: reset; ``observation`` is what its reset returned.
        observation: the first one.
        correcting: who acts.
        on_key_frame: observer, told of every key frame.
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
