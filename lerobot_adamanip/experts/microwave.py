"""Experts for the microwave (paper, appendix "Adaptive Manipulation Sequence").

Pull the door. If that fails, push the button, then pull again.
"""

from __future__ import annotations

from lerobot_adamanip.contract.keyframes import KeyFrames, Phase
from lerobot_adamanip.experts.belief import Hidden, Knowledge, Parts
from lerobot_adamanip.experts.doors import MAX_ROUNDS, open_by_trial, pull_door
from lerobot_adamanip.experts.primitives import Frames, Hand, Opening
from lerobot_adamanip.objects import PartAnnotation

PUSH = 0.03
"""Commanded depth of a push [m], past the travel of every button, so that the button's stop ends it."""
CHANGING_SEQUENCE = "push button with the closed hand; pull door; after a failed pull push and pull again"
SEQUENCE = "pull door; if it is blocked: let go, push button with the closed hand, pull again"


def adaptive(hand: Hand, known: Knowledge, *, is_shut: bool = False) -> KeyFrames:
    """Opens by trial and error, without the hidden state. Pushes first if ``is_shut``, or after a failed pull."""
    button, unlock_first = known.parts["button"], is_shut or hand.belief.blocked("door", until="button")
    if not unlock_first and hand.parts and hand.is_closed_near(button):
        yield from hand.back_off(0.0)  # as after a push: fingers that open in the button's recess are caught there
    yield from open_by_trial(hand, known.parts["handle"], lambda: push_button(hand, button), unlock_first=unlock_first)


def static(hand: Hand, parts: Parts, hidden: Hidden) -> KeyFrames:
    """Opens with knowledge of ``hidden["locked"]``: optimal under full observation."""
    handle = parts["handle"]
    for _ in range(MAX_ROUNDS):
        if hidden["locked"] and not hand.is_ajar(handle, "door"):
            yield from push_button(hand, parts["button"])
        if (yield from pull_door(hand, handle, "door")) is Opening.DONE:
            return
        yield from hand.release()


def changing(hand: Hand, known: Knowledge) -> KeyFrames:
    """Opens a microwave that is always locked and may lock again: pushes, pulls, and pushes after a failed pull."""
    is_pushed = any(each.joint == "button" and not each.failed for each in hand.belief.tries)
    yield from adaptive(hand, known, is_shut=not (is_pushed or hand.is_ajar(known.parts["handle"], "door")))


def changing_with_sight(hand: Hand, parts: Parts, hidden: Hidden) -> KeyFrames:
    """Opens it as `changing` does: sight of the hidden state saves no try."""
    yield from changing(hand, Knowledge(parts))


def push_button(hand: Hand, button: PartAnnotation) -> Frames:
    """Pushes the button to its stop with the closed hand, then backs off; the button springs back."""
    yield from hand.press(button)
    yield from hand.move_to(button.moved({**hand.positions, "button": PUSH}), 0.0, Phase.UNLOCK)
    yield from hand.back_off(0.0)
