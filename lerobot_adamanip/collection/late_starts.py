"""Late starts: episodes that start from perturbed mid-task states.

An expert that knows the hidden state acts for some unrecorded key frames. Then the fingers open and the hand moves away
by a random offset, and the recording starts. A policy thus learns to continue, for instance with an ajar door after a
lost grip. Experts that start at rest rarely show such states.
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
from lerobot_adamanip.contract.seeds import Stream, episode_generator
from lerobot_adamanip.episode.rollout import KeyframeEnvironment, SimulatedEnvironment, next_goal

KEY_FRAMES = (3, 12)
"""Minimum and maximum key frames of the unrecorded expert; fewer than it needs to succeed."""
BACK, SIDEWAYS, TURN = (0.05, 0.15), 0.03, 0.15
"""Motion of the hand: range backwards [m], standard deviations sideways [m] and of the rotation [rad]."""

Actions = NDArray[np.float32]


@dataclass(frozen=True)
class LateStart:
    """A late start of an episode.

    Attributes:
        key_frames: maximum key frames of the unrecorded expert.
        move: (4, 4) motion of the hand away from the part, in the hand's frame [m].
        seed, category: seed and category of the episode.
    """

    key_frames: int
    move: NDArray[np.float64]
    seed: int
    category: str

    @property
    def generator(self) -> np.random.Generator:
        """Returns a new generator for the unrecorded expert."""
        return episode_generator(self.seed, Stream.LATE_EXPERT, self.category)


def draw_start(seed: int, category: str, share: float) -> LateStart | None:
    """Samples the start of an episode from its seed and category; None for a start at rest."""
    rng = episode_generator(seed, Stream.LATE_START, category)
    if rng.random() >= share:
        return None
    back, sideways, turn = rng.uniform(*BACK), np.clip(rng.normal(size=2), -2, 2), np.clip(rng.normal(size=3), -2, 2)
    move = transform((*(SIDEWAYS * sideways), -back), Rotation.from_rotvec(TURN * turn).as_matrix())
    return LateStart(int(rng.integers(KEY_FRAMES[0], KEY_FRAMES[1] + 1)), move, seed, category)


def start_late(
    env: SimulatedEnvironment,
    start: LateStart,
    reset: Callable[[], Observation],
    make_expert: Callable[[np.random.Generator], KeyFrames],
) -> tuple[Observation, Actions]:
    """Brings an environment to a late start before success; uses fewer key frames if one would end the episode.

    Args:
        env: the environment.
        start: parameters of the late start.
        reset: restarts the episode; returns its first observation.
        make_expert: creates the unrecorded expert.

    Returns:
        The first observation, and the (n, 10) actions that led to it.
    """
    for limit in range(start.key_frames, 0, -1):
        reset()
        actions = []
        for goal in _driven(env, make_expert(start.generator), limit, start.move):
            actions.append(goal.action())
            if any(env.drive(actions[-1])):
                break
        else:
            env.restart_episode()
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
