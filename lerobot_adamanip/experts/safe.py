"""Experts for the safe (paper, appendix "Adaptive Manipulation Sequence").

Pull the door. If that fails, turn the knob: choose a direction at random, take the other one if it fails. Then pull
again. The adaptive expert knows the annotated part poses and what the arm felt; the static one also the hidden state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.experts.doors import pull_door
from lerobot_adamanip.experts.primitives import FOLLOWED, Frames, Hand
from lerobot_adamanip.keyframes import KeyFrames, Phase
from lerobot_adamanip.objects import PartAnnotation

TURN_STEP = np.deg2rad(40.0)
"""Knob angle of one key frame [rad]."""
MAX_TURNS = 4
"""Key frames in one direction; no knob turns farther than 4 x 40 degrees."""
MAX_ROUNDS = 3
"""Times the knob is visited before giving up."""
SEQUENCE = "pull door; if it is blocked: let go, turn knob one way at random, the other way if blocked, pull again"

Parts = Mapping[str, PartAnnotation]


def adaptive(parts: Parts, rng: np.random.Generator, *, trials: int = 1) -> KeyFrames:
    """Trial and error, as control flow. It never learns the hidden state."""
    hand, knob_angle = Hand(rng, trials), 0.0
    opened = yield from pull_door(hand, parts["handle"], "door")
    for _ in range(MAX_ROUNDS):
        if opened:
            return
        yield from hand.release()
        first = int(rng.choice([-1, 1]))
        knob_angle = yield from unlock(hand, parts["knob"], knob_angle, (first, -first))
        yield from hand.release()
        opened = yield from pull_door(hand, parts["handle"], "door", trials=1)


def static(parts: Parts, rng: np.random.Generator, *, hidden: Mapping[str, Any]) -> KeyFrames:
    """Optimal under full observation: straight to what opens it. ``hidden`` holds ``locked`` and ``direction``."""
    hand = Hand(rng)
    if hidden["locked"]:
        yield from unlock(hand, parts["knob"], 0.0, (int(hidden["direction"]),))
        yield from hand.release()
    yield from pull_door(hand, parts["handle"], "door")


def unlock(hand: Hand, knob: PartAnnotation, start: float, directions: tuple[int, ...]) -> Any:
    """Turns the knob until it stops, in the first direction that it follows. Returns its angle [rad]."""
    yield from hand.grasp(knob, {"knob": start})
    for direction in directions:
        yield from _turn_until_it_stops(hand, knob, start, direction)
        angle = hand.followed(knob, "knob")
        if direction * (angle - start) > FOLLOWED * TURN_STEP:
            return angle
        hand.trial += 1
        start = angle
    return start


def _turn_until_it_stops(hand: Hand, knob: PartAnnotation, start: float, direction: int) -> Frames:
    for turn in range(1, MAX_TURNS + 1):
        yield from hand.move(knob, "knob", start + direction * turn * TURN_STEP, Phase.UNLOCK)
        if hand.feedback.failed:
            return
