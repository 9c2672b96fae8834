"""Experts for the lamp (paper, appendix "Adaptive Manipulation Sequence").

Randomly choose to push, rotate clockwise or rotate counter-clockwise; never choose again what has failed.
"""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.contract.keyframes import FOLLOWED, KeyFrames, Phase
from lerobot_adamanip.experts.belief import Hidden, Knowledge, Parts
from lerobot_adamanip.experts.primitives import MAX_GRIPS, Attempt, Hand
from lerobot_adamanip.objects import PartAnnotation

PUSH = 0.018
"""How far a push goes [m]: past what switches the lamp on."""
TURN_STEP = np.deg2rad(30.0)
"""Knob angle of one key frame [rad]."""
MAX_TURNS = 6
MOTIONS = (("button", 1), ("knob", 1), ("knob", -1))
"""By mode: the joint and the direction that are free."""
TURNED = np.deg2rad(10.0)
"""A knob that stands this far from rest [rad] shows that it turns, and which way."""
MAX_ROUNDS = 2
"""Times all motions are gone through, if none has yielded: one whose grip slipped may have been the right one."""
SEQUENCE = "hold knob; push, turn + or turn - in random order, never again what failed, until one yields"


def adaptive(hand: Hand, known: Knowledge) -> KeyFrames:
    """Trial and error, as control flow. It never learns the hidden state."""
    knob = known.parts["knob"]
    yield from _hold(hand, knob)
    if abs(hand.at("knob")) > TURNED:
        yield from _attempt(hand, knob, 1 if hand.at("knob") > 0 else 2)
        return
    failed = _failed_before(hand)
    for number in range(MAX_ROUNDS):
        for mode in hand.rng.permutation(len(MOTIONS)):
            if number == 0 and mode in failed:
                continue
            for _ in range(hand.trials):
                if (yield from _attempt(hand, knob, int(mode))):
                    return
        yield from hand.regrasp(knob)


def static(hand: Hand, parts: Parts, hidden: Hidden) -> KeyFrames:
    """Optimal under full observation; ``hidden`` holds ``mode``."""
    yield from _hold(hand, parts["knob"])
    for _ in range(MAX_ROUNDS):
        if (yield from _attempt(hand, parts["knob"], int(hidden["mode"]))):
            return
        yield from hand.regrasp(parts["knob"])


def _hold(hand: Hand, knob: PartAnnotation) -> Attempt:
    hand.settles = {"button": 0.0}
    return (yield from hand.grasp(knob)) or (yield from hand.regrasp(knob))


def _failed_before(hand: Hand) -> set[int]:
    """Returns the modes that others have tried and failed; none if that is all: one that slipped tells nothing."""
    blocked = {("knob", way) for way in hand.belief.blocked_ways("knob", TURNED)}
    blocked |= {("button", 1)} if hand.belief.blocked("button") else set()
    failed = {mode for mode, motion in enumerate(MOTIONS) if motion in blocked}
    return failed if len(failed) < len(MOTIONS) else set()


def _attempt(hand: Hand, knob: PartAnnotation, mode: int) -> Attempt:
    """Pushes, or turns on as long as it yields; True if it did. About it again if the grip is torn off."""
    joint, direction = MOTIONS[mode]
    step, count = (PUSH, 1) if joint == "button" else (TURN_STEP, MAX_TURNS)
    start, number, grips = hand.at(joint), 1, 0
    while number <= count:
        goal = start + direction * number * step
        yield from hand.move(knob, joint, goal, Phase.TRY if number == 1 else Phase.OPEN)
        if hand.empty and grips < MAX_GRIPS:
            grips += 1
            yield from hand.regrasp(knob)
            continue
        if hand.feedback.failed:
            break
        number += 1
    if not hand.empty and direction * (hand.at(joint) - start) > FOLLOWED * step:
        return True
    hand.positions[joint] = start  # what does not yield is where it was; the hand gave way
    return False
