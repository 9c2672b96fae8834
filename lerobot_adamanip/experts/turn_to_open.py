"""Experts for parts that are turned and then opened: bottle, pen, pressure cooker, coffee maker, window and door.

Paper, appendix "Adaptive Manipulation Sequence": turn after a failed try to open. After a turn, turn further or try to
open, at random. If a direction fails, take the other one. The angle that frees the part is hidden. The first motion
may be a lift (bottle, pen, pressure cooker, coffee maker); a window or a door is turned first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from lerobot_adamanip.contract.keyframes import FOLLOWED, KeyFrames, Phase
from lerobot_adamanip.experts.belief import Hidden, Knowledge, Parts
from lerobot_adamanip.experts.primitives import HELD_WITHIN_M, Attempt, Frames, Hand, Opening
from lerobot_adamanip.objects import PartAnnotation

MAX_MOTIONS = 30
"""Turns, each with at most one try, before an adaptive expert gives up: twice as many as the widest range needs."""
MAX_OPENINGS = 3
"""Rounds of turning and opening by a static expert. It needs a second round only after a slipped grip."""
RELEASED = 0.9
"""Share of the range that a static expert turns; the final joint is free at 0.85."""
TURN_LAG_RATIO = 0.04
"""Lag of a turned part behind the hand, as a share of its angle."""
SLIPPED = 0.008
"""Distance [m] from its grasp, which moves with the joint, beyond which a hand has slipped along the part."""

MAX_SLIPS = 3
"""Slipped tries before the part is grasped again. A blocked pull often moves the hand a little, without harm."""


@dataclass(frozen=True)
class TurnToOpen:
    """Parameters of turning and opening one category.

    Attributes:
        part: the part that is held all the time.
        key, final: joints: the one that turns, the one that opens.
        step: angle of one turn [rad].
        opening: positions of the final joint [rad or m], one key frame each; the first is the try.
        p_open: probability of a try after a turn that the part followed.
        p_open_first: probability that the very first motion is a try.
        not_before: angle below which no try is made [rad]; from upstream's code, not the paper's text.
        enough: angle at which the final joint is free in every episode [rad]; no turn goes farther.
        settles: see `Hand`.
    """

    part: str
    key: str
    final: str
    step: float
    opening: tuple[float, ...]
    p_open: float = 0.5
    p_open_first: float = 0.5
    not_before: float = 0.0
    enough: float = np.inf
    settles: Mapping[str, float] = field(default_factory=dict)

    @property
    def sequence(self) -> str:
        """The expert's sequence in words."""
        first = "turn or open first, at random" if self.p_open_first else "turn first"
        then = f"after a turn open ({self.final}) with p = {self.p_open:g} or turn on; turn on after a blocked"
        if not self.p_open:
            then = f"turn on until it stops, then open ({self.final}); turn on after a blocked"
        return (
            f"hold {self.part}; {first}; turn {self.key} one way at random, the other way if blocked; "
            f"{then} {self.final}"
        )

    def upstream(self, not_before: float) -> TurnToOpen:
        """Returns the sequence of upstream's code: no try first, and none before the angle ``not_before`` [rad]."""
        return replace(self, p_open_first=0.0, not_before=not_before)

    def to_stop(self, enough: float) -> TurnToOpen:
        """Returns the sequence with the fewest tries: it first turns to the stop, or to the angle ``enough`` [rad]."""
        return replace(self, p_open=0.0, p_open_first=0.0, enough=enough)

    def adaptive(self, hand: Hand, known: Knowledge) -> KeyFrames:
        """Opens by trial and error, without the hidden state."""
        return TurnToOpenExpert(self, known.parts[self.part], hand).adaptive(known.direction)

    def static(self, hand: Hand, parts: Parts, hidden: Hidden) -> KeyFrames:
        """Opens with ``hidden["direction"]`` and ``hidden["turn_range"]``: optimal under full observation."""
        expert = TurnToOpenExpert(self, parts[self.part], hand)
        return expert.static(int(hidden["direction"]), float(hidden["turn_range"]))


LIFT = (0.015, 0.04)
SWING = tuple(np.deg2rad((10.0, 22.0, 33.0, 42.0)))
FALLS_SHUT = {"lift": 0.0}
BOTTLE = TurnToOpen("cap", "cap", "lift", np.deg2rad(30.0), LIFT, settles=FALLS_SHUT)
PRESSURE_COOKER = TurnToOpen("handle", "lid", "lift", np.deg2rad(12.0), LIFT, settles=FALLS_SHUT)
COFFEE_MAKER = TurnToOpen("handle", "portafilter", "drop", np.deg2rad(12.0), LIFT, settles={"drop": 0.05})
WINDOW = TurnToOpen("handle", "handle", "sash", np.deg2rad(20.0), SWING, p_open_first=0.0, settles={"handle": 0.0})
DOOR = TurnToOpen("lever", "lever", "leaf", np.deg2rad(18.0), SWING, p_open_first=0.0, settles={"lever": 0.0})


class TurnToOpenExpert:
    """One episode's expert; ``hand`` holds ``part`` and tracks its joints."""

    def __init__(self, style: TurnToOpen, part: PartAnnotation, hand: Hand) -> None:
        self.style, self.part, self.hand = style, part, hand
        self.direction = 1
        self.farthest = max(abs(hand.at(style.key)), hand.belief.farthest(style.key))
        self.blocked = hand.belief.blocked_at(style.final, style.key)
        """Largest angle of the key [rad] at which a try to open was blocked; -1 for none."""
        self.slips = 0
        """Tries with a slipped hand since the latest grasp."""
        self.at_end = hand.belief.stopped(style.key, FOLLOWED * style.step)
        self.at_end |= abs(self.angle) >= (1.0 - TURN_LAG_RATIO) * style.enough
        """Whether the key has turned to its stop, or far enough as far as a takeover can see."""
        hand.settles = style.settles

    @property
    def angle(self) -> float:
        """Measured angle of the key joint [rad]."""
        return self.hand.at(self.style.key)

    @property
    def is_free(self) -> bool:
        """Whether the final joint is known to be free: the key is at its stop, or has turned by ``enough``."""
        return self.at_end or abs(self.angle) >= self.style.enough

    def adaptive(self, fixed_direction: int | None) -> KeyFrames:
        """Finds direction and range by trial and error; tries to open at random, or once the joint should be free."""
        rng, style = self.hand.rng, self.style
        drawn = int(rng.choice([-1, 1]))
        turned = abs(self.angle) > FOLLOWED * style.step
        if self.hand.is_open(style.final, style.opening):
            return
        # A turned key shows its direction.
        known = fixed_direction or self.hand.belief.way(style.key, FOLLOWED * style.step)
        self.direction = int(np.sign(self.angle)) if turned else known or drawn
        yield from self._hold()
        may = rng.random() < (style.p_open if turned else style.p_open_first) or self.is_free
        ajar = self.hand.is_ajar(self.part, style.final)
        if (ajar or (may and self._is_new_angle())) and (yield from self._try_to_open()):
            return
        for _ in range(MAX_MOTIONS):
            followed = yield from self._turn()
            may = followed and abs(self.angle) >= style.not_before and rng.random() < style.p_open
            if (self.is_free or (may and self._is_new_angle())) and (yield from self._try_to_open()):
                return

    def _is_new_angle(self) -> bool:
        """Returns whether a try is allowed at this angle, and none was blocked at it or farther."""
        return abs(self.angle) >= max(self.style.not_before, self.blocked + FOLLOWED * self.style.step / 2)

    def static(self, direction: int, turn_range: float) -> KeyFrames:
        """Turns in the true direction, just far enough, and opens."""
        hand, style = self.hand, self.style
        if hand.is_open(style.final, style.opening):
            return
        yield from self._hold()
        for _ in range(MAX_OPENINGS):
            if not hand.is_ajar(self.part, style.final):
                yield from self._turn_to(direction, RELEASED * turn_range)
            if (yield from hand.open(self.part, style.final, style.opening)) is Opening.DONE:
                return
            yield from hand.regrasp(self.part)

    def _turn_to(self, direction: int, far: float) -> Frames:
        start, step = direction * self.angle, 2 * self.style.step
        for number in range(1, max(0, int(np.ceil((far - start) / step - 1e-9))) + 1):
            goal = direction * min(far, start + number * step)
            yield from self.hand.move(self.part, self.style.key, goal, Phase.UNLOCK)
            if self.hand.empty:
                yield from self.hand.regrasp(self.part)

    def _hold(self) -> Attempt:
        return (yield from self.hand.grasp(self.part)) or (yield from self.hand.regrasp(self.part))

    def _turn(self) -> Attempt:
        """Turns one step. Returns True if the key followed; after a blocked step the direction is reversed."""
        style, hand = self.style, self.hand
        start = self.angle
        # A key that sprang back returns to its old angle in double steps; larger ones feel like a stop.
        ahead = max(self.direction * start, self.farthest) + style.step - self.direction * start
        # Not farther than ``enough``, plus a little because the part lags behind the hand.
        left = (1.0 + TURN_LAG_RATIO) * style.enough - self.direction * start
        goal = start + self.direction * min(ahead, 2 * style.step, max(left, style.step / 2))
        yield from hand.move(self.part, style.key, goal, Phase.UNLOCK)
        if hand.empty or hand.slip(self.part, style.key) > HELD_WITHIN_M:
            yield from hand.regrasp(self.part)
            return False
        turned = self.direction * (self.angle - start)
        stopped = hand.feedback.failed and self.direction * self.angle > self.farthest - FOLLOWED * style.step
        self.farthest = max(self.farthest, self.direction * self.angle)
        if not hand.feedback.failed or turned > FOLLOWED * style.step:
            self.at_end = stopped
            return True
        if self.direction * self.angle > FOLLOWED * style.step:
            self.at_end = True  # it has turned this way before, so this is its stop
            return False
        hand.positions[style.key] = start  # a blocked joint has not moved; the hand gave way
        self.direction, self.farthest = -self.direction, 0.0
        return False

    def _try_to_open(self) -> Attempt:
        """Tries to open, up to ``hand.trials`` times while it is blocked. Returns True once it is open."""
        hand, style = self.hand, self.style
        self.blocked = max(self.blocked, abs(self.angle))
        for _ in range(hand.trials):
            opening = yield from hand.open(self.part, style.final, style.opening)
            if opening is Opening.DONE:
                return True
            if opening is not Opening.BLOCKED:
                break
        # A lever that is pulled askew slips in the fingers and springs back. It may slip again at each try.
        self.slips += hand.slip(self.part, style.final) > SLIPPED
        if self.slips == MAX_SLIPS:
            self.slips, self.at_end = 0, False
            yield from hand.regrasp(self.part)
        return False
