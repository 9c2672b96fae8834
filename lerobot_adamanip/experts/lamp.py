"""Experts for the lamp (paper, appendix "Adaptive Manipulation Sequence").

Randomly choose to push, rotate clockwise or rotate counter-clockwise; never choose again what has failed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.experts.primitives import FOLLOWED, Attempt, Hand
from lerobot_adamanip.keyframes import KeyFrames, Phase
from lerobot_adamanip.objects import PartAnnotation

PUSH = 0.018
"""How far a push goes [m]: past what switches the lamp on."""
TURN_STEP = np.deg2rad(30.0)
"""Knob angle of one key frame [rad]."""
MAX_TURNS = 6
MOTIONS = (("button", 1), ("knob", 1), ("knob", -1))
"""By mode: the joint and the direction that are free."""
SEQUENCE = "hold knob; push, turn + or turn - in random order, never again what failed, until one yields"

Parts = Mapping[str, PartAnnotation]


def adaptive(parts: Parts, rng: np.random.Generator, *, trials: int = 1) -> KeyFrames:
    """Trial and error, as control flow. It never learns the hidden state."""
    hand = Hand(rng, trials)
    yield from hand.grasp(parts["knob"])
    for mode in rng.permutation(len(MOTIONS)):
        for _ in range(trials):
            if (yield from _attempt(hand, parts["knob"], int(mode))):
                return
            hand.trial += 1


def static(parts: Parts, rng: np.random.Generator, *, hidden: Mapping[str, Any]) -> KeyFrames:
    """Optimal under full observation; ``hidden`` holds ``mode``."""
    hand = Hand(rng)
    yield from hand.grasp(parts["knob"])
    yield from _attempt(hand, parts["knob"], int(hidden["mode"]))


def _attempt(hand: Hand, knob: PartAnnotation, mode: int) -> Attempt:
    """Pushes, or turns on as long as it yields; True if it did."""
    joint, direction = MOTIONS[mode]
    step, count = (PUSH, 1) if joint == "button" else (TURN_STEP, MAX_TURNS)
    for number in range(1, count + 1):
        phase = Phase.TRY if number == 1 else Phase.OPEN
        yield from hand.move(knob, joint, direction * number * step, phase)
        if hand.feedback.failed:
            return number > 1 or direction * hand.followed(knob, joint) > FOLLOWED * step
    return True
