"""Demonstrations with mistakes: at some key frames the arm executes a mistaken version of the expert's action.

As in DART (Laskey et al. 2017), a row's ``action`` stays the expert's answer, and what was sent is the column
``complementary_info.executed``. So the data show states and failed tries that a policy reaches, and what to do next.
The expert takes over in the state that the mistake has led to, and knows all tries so far.

Mistakes: a motion stops short; an approaching hand closes on nothing; a closed hand moves the wrong way, lets go,
repeats the latest failed try, or pulls before the turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.collection.tries_so_far import TriesSoFar
from lerobot_adamanip.contract.keyframes import CLOSED_HAND, OPEN_HAND, Feedback, Goal, KeyFrameLabels, KeyFrames, Phase
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, straight_path, transform
from lerobot_adamanip.episode.rollout import RolloutResult, Run, next_goal, result_of

Array = NDArray[np.float64]
Action = NDArray[np.float32]
SHORT_SHARES = (0.3, 0.7)
"""Range of the share of a motion that one that stops short covers."""
EARLY_PULL_M = 0.05
"""Length of a pull before the turn [m]."""
SHORT, MISS, WRONG_WAY, LET_GO, REPEAT, EARLY_PULL = "short", "miss", "wrong way", "let go", "repeat", "early pull"


class Mistakes:
    """Draws the mistakes of one episode.

    Args:
        share: share of the key frames with a mistake.
        generator: random numbers of mistakes.
    """

    def __init__(self, share: float, generator: np.random.Generator) -> None:
        self._share, self._rng = share, generator
        self._failed: Array | None = None

    def draw(self, goal: Goal, feedback: Feedback) -> Action | None:
        """Returns a mistaken action (10,) in place of the expert's; None for no mistake.

        Args:
            goal: the expert's next key frame.
            feedback: of the key frame before, which says where the hand is.
        """
        if self._rng.random() >= self._share:
            return None
        here = feedback.tcp_in_base
        motion = np.linalg.inv(here) @ goal.tcp_in_base
        (short,) = straight_path(here, goal.tcp_in_base, np.array([self._rng.uniform(*SHORT_SHARES)]))
        choices = {SHORT: (short, goal.gripper)}
        if feedback.gripper > OPEN_HAND and goal.gripper > OPEN_HAND and goal.phase in (Phase.APPROACH, Phase.GRASP):
            choices[MISS] = (here, 0.0)
        if goal.gripper < CLOSED_HAND and feedback.gripper < OPEN_HAND and goal.phase in _CONTACT:
            choices |= {WRONG_WAY: (here @ np.linalg.inv(motion), 0.0), LET_GO: (here, 1.0)}
            if self._failed is not None:
                choices[REPEAT] = (here @ self._failed, 0.0)
            if goal.phase is Phase.UNLOCK:
                choices[EARLY_PULL] = (here @ transform((0.0, 0.0, -EARLY_PULL_M)), 0.0)
        return pose_vector(*choices[str(self._rng.choice(list(choices)))])

    def after(self, before: Array, sent: Array | Action, labels: KeyFrameLabels) -> None:
        """Remembers a failed try: the motion from a pose (4, 4) to a sent one, (4, 4) or an action (10,)."""
        if labels.failed:
            target = sent if sent.shape == before.shape else pose_from_vector(sent)[0]
            self._failed = np.linalg.inv(before) @ target


_CONTACT = (Phase.TRY, Phase.UNLOCK, Phase.OPEN)


@dataclass(frozen=True)
class MistakenExpert:
    """Expert of an episode with mistakes.

    Attributes:
        expert: of the whole episode, not yet primed.
        take_over: creates the expert that continues after a mistake, from ``belief`` and ``generator``.
        mistakes: of the episode.
        generator: random numbers of the experts that take over.
    """

    expert: KeyFrames
    take_over: Callable[..., KeyFrames]
    mistakes: Mistakes
    generator: np.random.Generator


def mistaken_rollout(run: Run, tries: TriesSoFar, driver: MistakenExpert) -> RolloutResult:
    """Runs an expert with mistakes in a freshly reset environment, until it ends. It makes none after success.

    Args:
        run: by key frames or at control rate; it continues after success.
        tries: of the environment.
        driver: the expert and its mistakes.
    """
    expert, has_taken_over = driver.expert, False
    goal = next(expert, None)
    while goal is not None and not run.has_ended:
        hand = run.feedback
        sent = None if run.success else driver.mistakes.draw(goal, hand)
        feedback = run.drive(goal, sent)
        if run.has_ended:
            break
        tries.end(feedback.outcome)
        driver.mistakes.after(hand.tcp_in_base, goal.tcp_in_base if sent is None else sent, tries.latest)
        has_taken_over |= sent is not None
        goal = next_goal(expert, feedback) if sent is None else None
        # After success an expert that takes over anew might never find that it has nothing left to do.
        if sent is not None or (goal is None and has_taken_over and not run.success):
            expert.close()
            expert = driver.take_over(belief=tries.belief, generator=driver.generator)
            goal = next(expert, None)
    expert.close()
    return result_of(run, "the expert ended without success")
