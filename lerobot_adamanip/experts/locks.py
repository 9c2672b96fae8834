"""Experts for locks in a row and for a lock that shuts again (mechanism rules ``row`` and ``changing``).

In a row of locks, each motion frees the next: the key (out, back, out again) or a pull. An expert tries one of both,
at random, and the other one if it is blocked. A lock that shuts again is noticed by a failed pull: the key is turned
back, and on if it goes on, or out again. The adaptive experts know the part poses and the arm's feedback; the static
ones also the hidden state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from lerobot_adamanip.contract.keyframes import FOLLOWED, KeyFrames, Phase
from lerobot_adamanip.experts.belief import Belief, Hidden, Knowledge, Parts
from lerobot_adamanip.experts.primitives import HAND_COMPLIANCE, Attempt, Frames, Hand
from lerobot_adamanip.experts.safe import TURN_STEP
from lerobot_adamanip.experts.turn_to_open import (
    BOTTLE,
    COFFEE_MAKER,
    DOOR,
    PRESSURE_COOKER,
    SWING,
    WINDOW,
    TurnToOpen,
)

KEY, PULL = "key", "pull"
LOCKS = 3
"""Number of locks in a row."""
MAX_MOTIONS = 12
"""Motions of key and part before an expert gives up: twice as many as the longest row needs."""
MAX_TURNS = 8
"""Key frames of one motion of the key; the widest sweep, from stop to stop, takes five."""
MAX_PULLS = 8
"""Key frames of one pull."""
MIN_PROGRESS = 1.5
"""Motion in one key frame of a pull, as a multiple of the hand's compliance, with less of which the part is held."""


@dataclass(frozen=True)
class Locks:
    """Parts and motions of a category with locks in a row, or a lock that shuts again.

    Attributes:
        key_part, part: the part that turns the key, and the part that is pulled; often one part.
        key, final: joints: the one that turns, the one that opens.
        step: angle of one key frame [rad].
        path: positions of the final joint [rad or m], one key frame each; the first is the try.
        settles: see `Hand`.
        p_pull: probability of a pull where a lock of a row may be freed by the key or by a pull.
    """

    key_part: str
    part: str
    key: str
    final: str
    step: float
    path: tuple[float, ...]
    settles: Mapping[str, float] = field(default_factory=dict)
    p_pull: float = 0.5

    @property
    def to_stop(self) -> Locks:
        """The same with the fewest failed tries at worst in a row of locks: the key is moved first."""
        return replace(self, p_pull=0.0)

    def adaptive(self, hand: Hand, known: Knowledge) -> KeyFrames:
        """Opens locks in a row by trial and error."""
        expert = LocksExpert(self, known.parts, hand)
        yield from expert.in_row(expert.draw_motion)

    def static(self, hand: Hand, parts: Parts, hidden: Hidden) -> KeyFrames:
        """Opens locks in a row with ``direction``, ``second_pulls`` and ``third_pulls`` of ``hidden``."""
        expert = LocksExpert(self, parts, hand)
        expert.direction = int(hidden["direction"])
        pulls = (False, bool(hidden["second_pulls"]), bool(hidden["third_pulls"]), True)
        yield from expert.in_row(lambda: PULL if pulls[min(expert.moves, LOCKS)] else KEY)

    def changing(self, hand: Hand, known: Knowledge) -> KeyFrames:
        """Opens a lock that may shut again, by trial and error."""
        yield from LocksExpert(self, known.parts, hand).until_it_stays_open(None)

    def changing_with_sight(self, hand: Hand, parts: Parts, hidden: Hidden) -> KeyFrames:
        """Opens a lock that may shut again with ``direction`` and ``later_direction`` of ``hidden``."""
        expert = LocksExpert(self, parts, hand)
        expert.direction = int(hidden["direction"])
        yield from expert.until_it_stays_open(int(hidden["later_direction"]))


class LocksExpert:
    """One episode's expert: holds one part after the other and tracks both joints.

    Attributes:
        direction: direction in which the key turns from rest, as far as known or guessed.
        moves: number of locks freed so far, as far as felt.
        blocked: motions that failed since the latest one that did not.
    """

    def __init__(self, style: Locks, parts: Parts, hand: Hand) -> None:
        self.style, self.parts, self.hand = style, parts, hand
        hand.settles = style.settles
        rest = FOLLOWED * style.step
        drawn = int(hand.rng.choice([-1, 1]))
        self.direction = int(np.sign(self.angle)) if self._is_out else hand.belief.way(style.key, rest) or drawn
        self.moves, self.blocked = _felt(hand.belief, style)
        if not self.moves:  # what a camera shows of motions before a takeover
            self.moves = int(self._is_out) + 2 * int(self._is_ajar and not self._is_out) + int(self._is_ajar)
        self._held = ""
        self._reached = 0.0  # where the hand was after a pull that failed, as a position of the part

    @property
    def angle(self) -> float:
        """Measured angle of the key joint [rad]."""
        return self.hand.at(self.style.key)

    @property
    def _is_out(self) -> bool:
        return abs(self.angle) > FOLLOWED * self.style.step

    @property
    def _is_ajar(self) -> bool:
        return self.hand.is_ajar(self.parts[self.style.part], self.style.final)

    def draw_motion(self) -> str:
        """Returns the next motion: one that has not failed since the latest success. The first lock needs the key.

        After tries before a takeover the key is first: draws of experts that take over one after the other differ.
        """
        if self.moves >= LOCKS and PULL not in self.blocked:
            return PULL
        if self.moves == 0 and KEY not in self.blocked:
            return KEY
        p_pull = 0.0 if self.hand.belief.tries else self.style.p_pull
        drawn = PULL if self.hand.rng.random() < p_pull else KEY
        other = KEY if drawn == PULL else PULL
        return other if drawn in self.blocked else drawn

    def in_row(self, next_motion: Callable[[], str]) -> KeyFrames:
        """Makes the motions that ``next_motion`` returns until the part is open."""
        was_out = self._is_out
        if (yield from self._finish_turn(0.0)):
            self.moves, self.blocked = self.moves + (was_out and not self._is_out), set()
        elif self._is_pulled:
            yield from self._pull()
        for _ in range(MAX_MOTIONS):
            if self.hand.is_open(self.style.final, self.style.path):
                return
            motion = next_motion()
            moved = yield from (self._move_key() if motion == KEY else self._pull())
            self.moves += moved
            if moved:
                self.blocked = _held(motion, self.moves)
            else:  # if both are blocked, one of them has slipped
                self.blocked = {motion}

    def until_it_stays_open(self, later_direction: int | None) -> KeyFrames:
        """Turns the key and pulls; after each failed pull turns the key anew, in ``later_direction`` if it is known."""
        belief, style = self.hand.belief, self.style
        self.moves = 0  # after a lock has shut again, the key may turn either way
        self.direction = self._latest_way() or self.direction
        if not self._is_ajar and not (yield from self._finish_turn()) and belief.blocked(style.final, until=style.key):
            yield from self._turn_anew(later_direction)
        elif not (self._is_out or self._is_ajar):
            yield from self._move_key()
        for _ in range(MAX_MOTIONS):
            yield from self._pull()
            if self.hand.is_open(self.style.final, self.style.path):
                return
            if not self._is_ajar:
                # The part has given way a little: a hand that turns the key nearer would push the part shut.
                shut, self.hand.positions[style.final] = self.hand.at(style.final), self._reached
                yield from self._turn_anew(later_direction)
                self.hand.positions[style.final] = shut

    def _latest_way(self) -> int:
        """Returns the direction out that the latest try of the key suggests; 0 without a try."""
        latest, key = self.hand.belief.latest(self.style.key), self.style.key
        if latest is None or abs(latest.after[key]) > FOLLOWED * self.style.step:
            return 0 if latest is None else int(np.sign(latest.after[key]))
        return -latest.sign if latest.failed or latest.stalled else latest.sign

    @property
    def _is_pulled(self) -> bool:
        """Whether the latest try before a takeover was a pull that the part followed, so that it may go on."""
        latest, final = next(reversed(self.hand.belief.tries), None), self.style.final
        if latest is None or latest.joint != final or latest.failed:
            return False
        return not latest.stalled or latest.after[final] - latest.before[final] >= self._least

    @property
    def _least(self) -> float:
        """Least motion of the part in a key frame of a pull [rad or m]; if it moves less, it is held."""
        return MIN_PROGRESS * HAND_COMPLIANCE[self.parts[self.style.part].motion(self.style.final).kind]

    def _finish_turn(self, back: float = np.inf) -> Attempt:
        """Turns a key on that was on its way at a takeover: out to its stop, or back to the angle ``back`` [rad].

        Returns True if it was on its way and followed.
        """
        belief, key = self.hand.belief, self.style.key
        latest, to = belief.latest(key), np.inf
        way = int(np.sign(self.angle)) if latest is None else latest.sign
        if latest is None or way * self.angle > 0:
            has_ended = not self._is_out or belief.stopped(key, FOLLOWED * self.style.step)
        else:
            least = min(abs(self.angle), abs(latest.after[key] - latest.before[key]))
            has_ended, to = latest.stalled or least < HAND_COMPLIANCE["revolute"], back
        is_other = self._is_ajar and (latest is None or latest is not belief.tries[-1])
        if has_ended or is_other or (latest is not None and latest.failed):
            return False
        return (yield from self._turn(way, to))

    def _turn_anew(self, known: int | None) -> Frames:
        """Turns the key back and on. If it stops at rest, or ``known`` says so, turns it out again."""
        if not self._is_out:
            self.direction = known or self.direction
            yield from self._move_key()
            return
        side = int(np.sign(self.angle))
        if known is None or known != side:
            yield from self._turn(-side)
            if self._is_out and np.sign(self.angle) != side:
                return
        else:
            yield from self._turn(-side, 0.0)
        if not (yield from self._turn(side)):
            # It goes neither on nor out: a lever has slipped in the fingers, which a pull at a shut lock may do.
            yield from self.hand.regrasp(self.parts[self.style.key_part])
            self.direction = known or -side
            yield from self._move_key()

    def _move_key(self) -> Attempt:
        """Moves the key to its other end. Returns True if it followed; from rest, one direction or the other."""
        if self._is_out:
            return (yield from self._turn(-int(np.sign(self.angle)), 0.0))
        directions = (self.direction,) if self.moves else (self.direction, -self.direction)
        for direction in directions:
            if (yield from self._turn(direction)):
                self.direction = direction
                return True
        return False

    def _turn(self, direction: int, to: float = np.inf) -> Attempt:
        """Turns the key to its stop, or to the angle ``to`` [rad] in ``direction``. Returns True if it followed."""
        hand, style = self.hand, self.style
        yield from self._hold(style.key_part)
        part, start = self.parts[style.key_part], self.angle
        for _ in range(MAX_TURNS):
            ahead = min(direction * self.angle + style.step, to)
            yield from hand.move(part, style.key, direction * ahead, Phase.UNLOCK)
            if hand.empty:
                yield from hand.regrasp(part)
            elif hand.feedback.failed or ahead == to:
                break
        if direction * (self.angle - start) > FOLLOWED * min(style.step, to - direction * start):
            return True
        # A blocked joint has not moved; the hand gave way, at a stop to both sides.
        is_at_stop = abs(start) > FOLLOWED * style.step and direction * start < 0
        hand.positions[style.key] = (start + self.angle) / 2 if is_at_stop else start
        return False

    def _pull(self) -> Attempt:
        """Pulls the part until it is open or held. Returns True if it followed."""
        hand, style = self.hand, self.style
        yield from self._hold(style.part)
        part, start = self.parts[style.part], hand.at(style.final)
        least = self._least
        for _ in range(MAX_PULLS):
            here = hand.at(style.final)
            ahead = [place for place in style.path if place > here + FOLLOWED * style.path[0]] or [style.path[-1]]
            phase = Phase.OPEN if hand.is_ajar(part, style.final) else Phase.TRY
            yield from hand.move(part, style.final, ahead[0], phase)
            if hand.empty:
                yield from hand.regrasp(part)
            elif hand.is_open(style.final, style.path):
                break
            elif hand.feedback.failed and hand.at(style.final) - here < least:
                self._reached = min(hand.at(style.final), HAND_COMPLIANCE[part.motion(style.final).kind])
                hand.positions[style.final] = here  # a blocked joint has not moved; the hand gave way
                break
        return hand.at(style.final) - start > least

    def _hold(self, name: str) -> Frames:
        """Grasps a part, after letting go of the other one; the hand keeps a part that it holds."""
        if self._held == name:
            return
        part = self.parts[name]
        if self._held:
            yield from self.hand.release()
        self._held = name
        if not (yield from self.hand.grasp(part)):
            yield from self.hand.regrasp(part)


def _held(motion: str, moves: int) -> set[str]:
    """Returns the motions that are blocked after a motion that frees a lock: a part that is pulled stops at a notch."""
    return {PULL} if motion == PULL and moves < LOCKS else set()


def _felt(belief: Belief, style: Locks) -> tuple[int, set[str]]:
    """Returns the number of motions that tries before a takeover have made, and those that failed since the latest."""
    moves, blocked, ways, latest, rest = 0, set[str](), set[int](), "", FOLLOWED * style.step
    for each in belief.tries:
        motion, before = PULL if each.joint == style.final else KEY, each.sign * each.before[style.key]
        if not each.failed:
            moves += latest != PULL if motion == PULL else (abs(each.after[style.key]) > rest) != (abs(before) > rest)
            blocked, ways, latest = _held(motion, moves), set(), motion
        elif motion == PULL or before < -rest:
            blocked, ways = {motion}, set()
        elif before < rest:  # farther out it is at its stop
            ways = ways | {each.sign}
            if moves or len(ways) > 1:  # the first lock is freed by one direction or the other
                blocked, ways = {motion}, set()
    return moves, blocked


def _of(style: TurnToOpen) -> Locks:
    return Locks(style.part, style.part, style.key, style.final, 2 * style.step, style.opening, style.settles)


LOCKS_OF: Mapping[str, Locks] = {
    "bottle": _of(BOTTLE),
    "pen": _of(BOTTLE),
    "pressure_cooker": _of(PRESSURE_COOKER),
    "coffee_maker": _of(COFFEE_MAKER),
    "safe": Locks("knob", "handle", "knob", "door", TURN_STEP, SWING),
    "window": _of(WINDOW),
    "door": _of(DOOR),
}
"""Category -> parts and motions."""
ROW_SEQUENCE = (
    "turn key one way at random, the other way if blocked; then move key or pull, at random, until it is open"
)
CHANGING_SEQUENCE = "turn key one way at random, the other way if blocked; pull; after a failed pull turn key anew"
