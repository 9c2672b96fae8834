"""Pulling a hinged door by its handle: shared by safe and microwave."""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.experts.primitives import EMPTY_HAND, FOLLOWED, Attempt, Hand
from lerobot_adamanip.keyframes import Phase
from lerobot_adamanip.objects import PartAnnotation

PULL_ANGLES = tuple(np.deg2rad((10.0, 22.0, 33.0, 42.0)))
"""Door angles of the pulls [rad]; the first is the try."""


def pull_door(hand: Hand, handle: PartAnnotation, joint: str, *, trials: int | None = None) -> Attempt:
    """Holds the handle and pulls it along its arc; True if the door came along. Tries ``trials`` times."""
    yield from hand.grasp(handle)
    for _ in range(hand.trials if trials is None else trials):
        if (yield from _pull(hand, handle, joint)):
            return True
    return False


def _pull(hand: Hand, handle: PartAnnotation, joint: str) -> Attempt:
    for number, angle in enumerate(PULL_ANGLES):
        yield from hand.move(handle, joint, angle, Phase.TRY if number == 0 else Phase.OPEN)
        blocked = number == 0 and hand.feedback.failed and hand.followed(handle, joint) < FOLLOWED * angle
        if blocked or hand.feedback.gripper < EMPTY_HAND:
            hand.trial += 1
            return False
    yield from hand.retry(handle, joint, PULL_ANGLES[-1])
    return True
