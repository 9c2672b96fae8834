"""Late starts: episodes that begin where another hand has left off, with its grip torn.

An expert that knows the hidden state drives some key frames, unrecorded; then the fingers open and the hand is moved
off by a random way. What is recorded begins there. So a policy learns to go on with an ajar door, which it reaches
itself whenever a grip slips, and experts that start at rest hardly ever show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrames, Phase
from lerobot_adamanip.contract.observation import Observation
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.episode.rollout import KeyframeEnvironment, SimulatedEnvironment, next_goal

KEY_FRAMES = (3, 12)
"""An expert drives at least and at most so many. Fewer than it needs to succeed."""
BACK, SIDEWAYS, TURN = (0.05, 0.15), 0.03, 0.15
"""The hand is moved back by so much [m], and by normal draws of these deviations sideways [m] and in rotation [rad]."""
_STREAM = 2
"""Tells these draws from any other that starts from the episode's seed."""

Actions = NDArray[np.float32]


@dataclass(frozen=True)
class LateStart:
    """How an episode starts late.

    Attributes:
        key_frames: that an expert drives at most.
        move: (4, 4) pose to which the hand is moved off, in its own frame at the time [m].
        seed: of the episode.
    """

    key_frames: int
    move: NDArray[np.float64]
    seed: int

    @property
    def generator(self) -> np.random.Generator:
        """Returns a fresh generator for the expert that drives."""
        return np.random.default_rng([self.seed, _STREAM, 1])


def draw_start(seed: int, share: float) -> LateStart | None:
    """Draws how the episode of ``seed`` starts: None at rest; depends on nothing else, so not on the expert."""
    rng = np.random.default_rng([seed, _STREAM])
    if rng.random() >= share:
        return None
    back, sideways, turn = rng.uniform(*BACK), np.clip(rng.normal(size=2), -2, 2), np.clip(rng.normal(size=3), -2, 2)
    move = transform((*(SIDEWAYS * sideways), -back), Rotation.from_rotvec(TURN * turn).as_matrix())
    return LateStart(int(rng.integers(KEY_FRAMES[0], KEY_FRAMES[1] + 1)), move, seed)


def start_late(
    env: SimulatedEnvironment,
    start: LateStart,
    reset: Callable[[], Observation],
    make_expert: Callable[[np.random.Generator], KeyFrames],
) -> tuple[Observation, Actions]:
    """Brings an environment into a late state that is no success yet: fewer key frames are driven if one succeeds.

    Args:
        env: to be brought there.
        start: how.
        reset: starts the episode anew; returns its first observation.
        make_expert: returns the expert that drives.

    Returns:
        The observation there, and the (n, 10) actions that led to it.
    """
    for limit in range(start.key_frames, 0, -1):
        reset()
        actions = []
        for goal in _driven(env, make_expert(start.generator), limit, start.move):
            actions.append(goal.action())
            succeeded, _ = env.drive(actions[-1])
            if succeeded:
                break
        else:
            return env.observe(), np.stack(actions)
    return reset(), np.zeros((0, ACTION_DIM), np.float32)


def _driven(env: KeyframeEnvironment, expert: KeyFrames, limit: int, move: NDArray[np.float64]) -> Any:
    goal = next(expert, None)
    for _ in range(limit):
        if goal is None:
            break
        yield goal
        goal = next_goal(expert, env.feedback)
    expert.close()
    here: Feedback = env.feedback
    yield Goal(here.tcp_in_base, 1.0, Phase.RELEASE)
    yield Goal(env.feedback.tcp_in_base @ move, 1.0, Phase.RELEASE)
