"""Experts for the microwave (paper, appendix "Adaptive Manipulation Sequence").

Pull the door. If that fails, push the button, then pull again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.experts.doors import pull_door
from lerobot_adamanip.experts.primitives import Frames, Hand
from lerobot_adamanip.keyframes import KeyFrames, Phase
from lerobot_adamanip.objects import PartAnnotation

PUSH = 0.03
"""How far a push goes [m]: past the end of any button's travel, so that it ends where the button stops."""
MAX_ROUNDS = 3
"""Times the button is pushed before giving up."""
SEQUENCE = "pull door; if it is blocked: let go, push button with the closed hand, pull again"

Parts = Mapping[str, PartAnnotation]


def adaptive(parts: Parts, rng: np.random.Generator, *, trials: int = 1) -> KeyFrames:
    """Trial and error, as control flow. It never learns the hidden state."""
    hand = Hand(rng, trials)
    opened = yield from pull_door(hand, parts["handle"], "door")
    for _ in range(MAX_ROUNDS):
        if opened:
            return
        yield from hand.release()
        yield from push_button(hand, parts["button"])
        opened = yield from pull_door(hand, parts["handle"], "door", trials=1)


def static(parts: Parts, rng: np.random.Generator, *, hidden: Mapping[str, Any]) -> KeyFrames:
    """Optimal under full observation; ``hidden`` holds ``locked``."""
    hand = Hand(rng)
    if hidden["locked"]:
        yield from push_button(hand, parts["button"])
    yield from pull_door(hand, parts["handle"], "door")


def push_button(hand: Hand, button: PartAnnotation) -> Frames:
    """Pushes with the closed hand until the button stops it, and backs off."""
    yield from hand.press(button)
    yield from hand.move(button, "button", PUSH, Phase.UNLOCK)
    yield from hand.back_off(0.0)
