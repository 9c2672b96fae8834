"""Experts for the lamp (paper, appendix "Adaptive Manipulation Sequence").

Randomly choose to push, rotate clockwise or rotate counter-clockwise; never repeat a failed choice.
"""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.contract.keyframes import FOLLOWED, KeyFrames, Phase
from lerobot_adamanip.experts.belief import Hidden, Knowledge, Parts
from lerobot_adamanip.experts.primitives import MAX_GRIPS, Attempt, Hand
from lerobot_adamanip.objects import PartAnnotation

PUSH = 0.018
"""Commanded depth of a push [m], deeper than switching on needs."""
TURN_STEP = np.deg2rad(30.0)
"""Knob angle of one key frame [rad]."""
MAX_TURNS = 6
MOTIONS = (("button", 1), ("knob", 1), ("knob", -1))
"""Free joint and direction of each mode."""
TURNED = np.deg2rad(10.0)
"""A knob this far from rest [rad] is known to turn, and in which direction."""
MAX_ROUNDS = 2
"""Rounds through all motions if none succeeds: the grip may have slipped in the right one."""
SEQUENCE = "hold knob; push, turn + or turn - in random order, never again what failed, until one yields"


def adaptive(hand: Hand, known: Knowledge) -> KeyFrames:
    """Switches on by trial and error, without the hidden state."""
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
    """Switches on in the mode of ``hidden["mode"]``: optimal under full observation."""
    yield from _hold(hand, parts["knob"])
    for _ in range(MAX_ROUNDS):
        if (yield from _attempt(hand, parts["knob"], int(hidden["mode"]))):
            return
        yield from hand.regrasp(parts["knob"])


def _hold(hand: Hand, knob: PartAnnotation) -> Attempt:
    hand.settles = {"button": 0.0}
    return (yield from hand.grasp(knob)) or (yield from hand.regrasp(knob))


def _failed_before(hand: Hand) -> set[int]:
    """Returns the modes that failed before; empty if all did, because one of them must have slipped."""
    blocked = {("knob", way) for way in hand.belief.blocked_ways("knob", TURNED)}
    blocked |= {("button", 1)} if hand.belief.blocked("button") else set()
    failed = {mode for mode, motion in enumerate(MOTIONS) if motion in blocked}
    return failed if len(failed) < len(MOTIONS) else set()


def _attempt(hand: Hand, knob: PartAnnotation, mode: int) -> Attempt:
    """Pushes once, or turns while the knob follows. Returns True if it followed. Grasps again if the grip is lost."""
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
    hand.positions[joint] = start  # a blocked joint has not moved; the hand gave way
    return False
