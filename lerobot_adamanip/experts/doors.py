"""Pulling a hinged door by its handle: shared by safe and microwave."""

from __future__ import annotations

from collections.abc import Callable, Generator

from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrames
from lerobot_adamanip.experts.primitives import Frames, Hand, Opening
from lerobot_adamanip.experts.turn_to_open import SWING
from lerobot_adamanip.objects import PartAnnotation

MAX_ROUNDS = 3
"""Largest number of changes between key and handle before an expert gives up."""


def pull_door(hand: Hand, handle: PartAnnotation, joint: str, tries: int = 1) -> Generator[Goal, Feedback, Opening]:
    """Grasps the handle where the door stands and pulls along its arc, up to ``tries`` times while it is blocked."""
    if not (yield from hand.grasp(handle)):
        yield from hand.regrasp(handle)
    opening = Opening.BLOCKED
    for _ in range(tries):
        opening = yield from hand.open(handle, joint, SWING)
        if opening is not Opening.BLOCKED:
            break
    return opening


def open_by_trial(hand: Hand, handle: PartAnnotation, unlock: Callable[[], Frames], *, unlock_first: bool) -> KeyFrames:
    """Pulls the door; if it is blocked, runs ``unlock`` until the hand is free again, and pulls again.

    ``unlock_first`` starts with ``unlock``, because a pull failed before this expert took over.
    """
    unlocking = unlock_first and not hand.is_ajar(handle, "door")
    for number in range(MAX_ROUNDS + 1):
        if not unlocking:
            opening = yield from pull_door(hand, handle, "door", hand.trials if number == 0 else 1)
            if opening is Opening.DONE:
                return
            yield from hand.release()
        unlocking = False
        if not hand.is_ajar(handle, "door"):
            yield from unlock()
