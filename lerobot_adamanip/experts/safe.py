"""Experts for the safe (paper, appendix "Adaptive Manipulation Sequence").

Pull the door. If that fails, turn the knob: choose a direction at random, take the other one if it fails. Then pull
again. The adaptive expert knows the annotated part poses and the arm's feedback; the static one also the hidden state.
"""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.contract.keyframes import FOLLOWED, KeyFrames, Phase
from lerobot_adamanip.experts.belief import Hidden, Knowledge, Parts
from lerobot_adamanip.experts.doors import MAX_ROUNDS, open_by_trial, pull_door
from lerobot_adamanip.experts.primitives import Attempt, Frames, Hand, Opening
from lerobot_adamanip.objects import PartAnnotation

TURN_STEP = np.deg2rad(40.0)
"""Knob angle of one key frame [rad]."""
MAX_TURNS = 4
"""Key frames in one direction; no knob turns farther than 4 x 40 degrees."""
TURNED = np.deg2rad(10.0)
"""A knob this far from rest [rad] shows in which direction it turns."""
RELEASED = 0.9
"""Share of its range beyond which a knob has certainly released the door; the mechanism releases at 0.85."""
SEQUENCE = "pull door; if it is blocked: let go, turn knob one way at random, the other way if blocked, pull again"


def adaptive(hand: Hand, known: Knowledge) -> KeyFrames:
    """Opens by trial and error, without the hidden state."""

    def unlock() -> Frames:
        first = hand.belief.way("knob", TURNED) or known.direction or int(hand.rng.choice([-1, 1]))
        yield from turn_knob(hand, known.parts["knob"], (first, -first))
        yield from hand.release()

    # If the knob is partly turned at the takeover, turn it further.
    blocked = hand.belief.blocked("door", until="knob")
    yield from open_by_trial(hand, known.parts["handle"], unlock, unlock_first=blocked or _turns(hand))


def _turns(hand: Hand) -> bool:
    """Returns whether the knob was being turned at the takeover and has not reached its stop."""
    latest = hand.belief.tries[-1] if hand.belief.tries else None
    return latest is not None and latest.joint == "knob" and not hand.belief.stopped("knob", TURNED)


def static(hand: Hand, parts: Parts, hidden: Hidden) -> KeyFrames:
    """Opens with knowledge of ``hidden["locked"]`` and ``hidden["direction"]``: optimal under full observation."""
    handle = parts["handle"]
    for _ in range(MAX_ROUNDS):
        if hidden["locked"] and not hand.is_ajar(handle, "door") and not _is_released(hand, hidden):
            yield from turn_knob(hand, parts["knob"], (int(hidden["direction"]),))
            yield from hand.release()
        if (yield from pull_door(hand, handle, "door")) is Opening.DONE:
            return
        yield from hand.release()


def turn_knob(hand: Hand, knob: PartAnnotation, directions: tuple[int, ...]) -> Frames:
    """Turns the knob to its stop, in the first free one of ``directions`` or in the direction of an earlier turn."""
    if not (yield from hand.grasp(knob)):
        yield from hand.regrasp(knob)
    if abs(hand.at("knob")) > TURNED:
        directions = (int(np.sign(hand.at("knob"))),)
    for direction in directions:
        if (yield from _turn_until_it_stops(hand, knob, direction)):
            return


def _turn_until_it_stops(hand: Hand, knob: PartAnnotation, direction: int) -> Attempt:
    """Turns in one direction to the stop. Returns True if the knob followed."""
    start = hand.at("knob")
    for turn in range(1, MAX_TURNS + 1):
        yield from hand.move(knob, "knob", start + direction * turn * TURN_STEP, Phase.UNLOCK)
        if hand.empty:
            yield from hand.regrasp(knob)
        elif hand.feedback.failed:
            break
    if direction * (hand.at("knob") - start) > FOLLOWED * TURN_STEP:
        return True
    hand.positions["knob"] = start  # a blocked joint has not moved; the hand gave way
    return False


def _is_released(hand: Hand, hidden: Hidden) -> bool:
    return abs(hand.at("knob")) > RELEASED * float(hidden.get("knob_range", np.inf))
