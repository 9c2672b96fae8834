"""What every expert does with its hand: approach, hold, push, let go; and notice what the held part did."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lerobot_adamanip.keyframes import PRE_GRASP, Feedback, Goal, Phase
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.rotations import transform

JITTER_POSITION, JITTER_ROTATION = 0.012, 0.06
"""Standard deviation of a pre-grasp about its nominal pose [m, rad], cut at two. Only the grasp has to be exact; what
leads there varies, so that a policy learns to correct the last 10 cm by what it sees."""
FOLLOWED = 0.5
"""A part that has covered this share of a commanded motion follows; one that has not is blocked."""
EMPTY_HAND = 0.05
"""Finger opening below which nothing is between them: the grip was torn off."""
MAX_APPROACHES = 3
"""Ways to a part that are tried: the arm may get stuck, at its limits or at what stands beside the part."""
MAX_PULLS = 3
"""More pulls at what came along and stalled before it was open."""
REST: Mapping[str, float] = {}

Frames = Generator[Goal, Feedback, None]
Attempt = Generator[Goal, Feedback, bool]


@dataclass
class Hand:
    """One episode's hand: what it felt last, and how often it has tried.

    Attributes:
        rng: decides what an expert leaves to chance.
        trials: how often a motion that does not yield is repeated before the mind is changed (paper's Table 2; 1 is
            theirs).
        trial: tries that came before, a label.
        feedback: the latest.
    """

    rng: np.random.Generator
    trials: int = 1
    trial: int = 0
    feedback: Feedback = field(init=False)

    def move_to(self, pose: NDArray[np.float64], gripper: float, phase: Phase) -> Frames:
        """One key frame."""
        self.feedback = yield Goal(pose, gripper, phase, self.trial)

    def grasp(self, part: PartAnnotation, positions: Mapping[str, float] = REST) -> Frames:
        """Goes to a part whose joints stand at ``positions``, and closes the fingers."""
        grasp = part.moved(positions)
        for _ in range(MAX_APPROACHES):
            yield from self.move_to(before(grasp) @ self._jitter(), 1.0, Phase.APPROACH)
            yield from self.move_to(grasp, 1.0, Phase.APPROACH)
            if not self.feedback.failed:
                break
        yield from self.move_to(grasp, 0.0, Phase.GRASP)

    def press(self, part: PartAnnotation) -> Frames:
        """Goes to a part with the fingers closed, to push it."""
        yield from self.move_to(before(part.grasp) @ self._jitter(), 0.0, Phase.APPROACH)
        yield from self.move_to(part.grasp, 0.0, Phase.APPROACH)

    def release(self) -> Frames:
        """Opens the fingers where they are, and backs off."""
        yield from self.move_to(self.feedback.tcp_in_base, 1.0, Phase.RELEASE)
        yield from self.back_off(1.0)

    def back_off(self, gripper: float) -> Frames:
        """Retreats along the approach."""
        yield from self.move_to(before(self.feedback.tcp_in_base), gripper, Phase.RELEASE)

    def move(
        self, part: PartAnnotation, joint: str, position: float, phase: Phase, others: Mapping[str, float] = REST
    ) -> Frames:
        """Moves a held part until ``joint`` stands at ``position`` [rad or m], ``others`` where they are."""
        yield from self.move_to(part.moved({**others, joint: position}), 0.0, phase)

    def retry(self, part: PartAnnotation, joint: str, position: float, others: Mapping[str, float] = REST) -> Frames:
        """Repeats a motion that has stalled on its way: from where the hand is now, a stiff joint comes farther."""
        for _ in range(MAX_PULLS):
            if not self.feedback.failed:
                return
            yield from self.move(part, joint, position, Phase.OPEN, others)

    def followed(self, part: PartAnnotation, joint: str, others: Mapping[str, float] = REST) -> float:
        """Returns where ``joint`` stands [rad or m], as the hand that holds its part tells."""
        at_zero = part.moved({**others, joint: 0.0})
        return part.motion(joint).followed(at_zero, self.feedback.tcp_in_base)

    def _jitter(self) -> NDArray[np.float64]:
        shift = JITTER_POSITION * np.clip(self.rng.normal(size=3), -2, 2)
        turn = JITTER_ROTATION * np.clip(self.rng.normal(size=3), -2, 2)
        return transform(shift, Rotation.from_rotvec(turn).as_matrix())


def before(grasp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the (4, 4) pose `PRE_GRASP` short of a grasp, along its approach."""
    return grasp @ transform((0.0, 0.0, -PRE_GRASP))
