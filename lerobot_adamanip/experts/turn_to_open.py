"""Experts for what is turned and then opened: bottle, pen, pressure cooker, coffee maker, window and door.

Paper, appendix "Adaptive Manipulation Sequence": turn after a failed try at opening; after a turn, either turn on or
try to open, at random; if a direction fails, take the other one. Nobody sees how far is far enough. A lift may come
first (bottle, pen, pressure cooker, coffee maker); a window or a door is turned first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lerobot_adamanip.experts.primitives import EMPTY_HAND, FOLLOWED, Attempt, Hand
from lerobot_adamanip.keyframes import KeyFrames, Phase
from lerobot_adamanip.objects import PartAnnotation

MAX_OPENINGS = 3
"""Times a static expert goes about opening; more than once only after a grip that slipped."""
RELEASED = 0.9
"""Share of the range a static expert turns through: the final joint is free at 0.85."""


@dataclass(frozen=True)
class TurnToOpen:
    """How one category is turned and opened.

    Attributes:
        part: that is held all the time.
        key, final: joints: the one that turns, the one that opens.
        step: angle of one turn [rad].
        opening: positions of the final joint [rad or m], one key frame each; the first is the try.
        p_open: probability of a try after a turn that the part followed.
        p_open_first: probability that the very first motion is a try.
        not_before: angle below which no try is made [rad]; upstream's code, not the paper's text.
    """

    part: str
    key: str
    final: str
    step: float
    opening: tuple[float, ...]
    p_open: float = 0.5
    p_open_first: float = 0.5
    not_before: float = 0.0

    @property
    def sequence(self) -> str:
        """The expert's sequence in words."""
        first = "turn or open first, at random" if self.p_open_first else "turn first"
        return (
            f"hold {self.part}; {first}; turn {self.key} one way at random, the other way if blocked; after a turn "
            f"open ({self.final}) with p = {self.p_open:g} or turn on; turn on after a blocked {self.final}"
        )


LIFT = (0.015, 0.04)
SWING = tuple(np.deg2rad((10.0, 22.0, 33.0, 42.0)))
TURN_TO_OPEN = {
    "bottle": TurnToOpen("cap", "cap", "lift", np.deg2rad(30.0), LIFT),
    "pen": TurnToOpen("cap", "cap", "lift", np.deg2rad(30.0), LIFT),
    "pressure_cooker": TurnToOpen("handle", "lid", "lift", np.deg2rad(12.0), LIFT),
    "coffee_maker": TurnToOpen("handle", "portafilter", "drop", np.deg2rad(12.0), LIFT),
    "window": TurnToOpen("handle", "handle", "sash", np.deg2rad(20.0), SWING, p_open_first=0.0),
    "door": TurnToOpen("lever", "lever", "leaf", np.deg2rad(18.0), SWING, p_open_first=0.0),
}

UPSTREAM_NOT_BEFORE = {
    "bottle": 0.99875, "pen": 0.99875, "pressure_cooker": 0.35, "coffee_maker": 0.34, "window": 0.6673, "door": 0.44625,
}  # fmt: skip
"""Angles [rad] that upstream's experts turn through before their first try: the least that can be enough."""


def upstream(category: str) -> TurnToOpen:
    """Returns a category as upstream's code has it: no try first, and none before an angle that can be enough."""
    return replace(TURN_TO_OPEN[category], p_open_first=0.0, not_before=UPSTREAM_NOT_BEFORE[category])


@dataclass
class TurnToOpenExpert:
    """One episode's expert: where the key stands, which directions are known not to work.

    Attributes:
        twist: the category.
        part: annotation of what is held, robot base frame.
        hand: that holds it.
        angle: of the key joint, as felt [rad].
        direction: being turned in.
        at_end: whether the key has been felt to stop after it had turned: it turns no farther.
    """

    twist: TurnToOpen
    part: PartAnnotation
    hand: Hand
    angle: float = 0.0
    direction: int = 1
    at_end: bool = False

    def adaptive(self) -> KeyFrames:
        """Trial and error, as control flow."""
        rng, twist = self.hand.rng, self.twist
        self.direction = int(rng.choice([-1, 1]))
        yield from self.hand.grasp(self.part)
        if rng.random() < twist.p_open_first and (yield from self._try_to_open()):
            return
        while True:
            followed = yield from self._turn()
            may = followed and abs(self.angle) >= twist.not_before and rng.random() < twist.p_open
            if (self.at_end or may) and (yield from self._try_to_open()):
                return

    def static(self, direction: int, turn_range: float) -> KeyFrames:
        """Optimal under full observation: the true direction, just far enough, then open."""
        yield from self.hand.grasp(self.part)
        far = RELEASED * turn_range
        for number in range(1, int(np.ceil(far / (2 * self.twist.step))) + 1):
            self.angle = direction * min(far, number * 2 * self.twist.step)
            yield from self.hand.move(self.part, self.twist.key, self.angle, Phase.UNLOCK)
        for _ in range(MAX_OPENINGS):
            if (yield from self._open()):
                return

    def _turn(self) -> Attempt:
        """One step in the present direction, or the other one if this is known to be blocked. True if it followed."""
        twist, hand = self.twist, self.hand
        start = self.angle
        goal = start + self.direction * twist.step
        yield from hand.move(self.part, twist.key, goal, Phase.UNLOCK)
        if (yield from self._held_again()):
            return False
        self.angle = hand.followed(self.part, twist.key)
        turned = self.direction * (self.angle - start)
        if not hand.feedback.failed or turned > FOLLOWED * twist.step:
            self.at_end = hand.feedback.failed
            return True
        if self.direction * self.angle > FOLLOWED * twist.step:
            self.at_end = True  # it has turned this way before, and has come to its stop
            return False
        hand.trial += 1
        self.direction = -self.direction
        return False

    def _held_again(self) -> Attempt:
        """True if the grip had been torn off; the part is then held anew, where it was felt last."""
        if self.hand.feedback.gripper > EMPTY_HAND:
            return False
        yield from self.hand.release()
        yield from self.hand.grasp(self.part, {self.twist.key: self.angle})
        return True

    def _try_to_open(self) -> Attempt:
        for _ in range(self.hand.trials):
            if (yield from self._open()):
                return True
            self.hand.trial += 1
        return False

    def _open(self) -> Attempt:
        """Moves the final joint; True if it came along."""
        twist, hand = self.twist, self.hand
        key = {twist.key: self.angle}
        for number, position in enumerate(twist.opening):
            phase = Phase.TRY if number == 0 else Phase.OPEN
            yield from hand.move(self.part, twist.final, position, phase, key)
            if (yield from self._held_again()):
                return False
            followed = hand.followed(self.part, twist.final, key)
            # Also later on: a grip that slips leaves the final joint behind, and the hand has to go about it anew.
            if hand.feedback.failed and followed < FOLLOWED * position:
                return False
        yield from hand.retry(self.part, twist.final, twist.opening[-1], key)
        return True


def adaptive(
    twist: TurnToOpen, parts: Mapping[str, PartAnnotation], rng: np.random.Generator, *, trials: int
) -> KeyFrames:
    """Returns the adaptive expert's key frames. It never learns the hidden state."""
    return TurnToOpenExpert(twist, parts[twist.part], Hand(rng, trials)).adaptive()


def static(
    twist: TurnToOpen, parts: Mapping[str, PartAnnotation], rng: np.random.Generator, *, hidden: Mapping[str, Any]
) -> KeyFrames:
    """Returns the static expert's key frames; ``hidden`` holds ``direction`` and ``turn_range``."""
    expert = TurnToOpenExpert(twist, parts[twist.part], Hand(rng))
    return expert.static(int(hidden["direction"]), float(hidden["turn_range"]))
