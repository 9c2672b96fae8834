"""Scripted experts: generators that yield key frames and branch on the robot's feedback."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrames, Outcome, Phase
from lerobot_adamanip.experts import lamp, locks, microwave, safe, turn_to_open
from lerobot_adamanip.experts.belief import Belief, Hidden, Knowledge, Parts
from lerobot_adamanip.experts.primitives import Hand
from lerobot_adamanip.experts.turn_to_open import TurnToOpen
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES, fixed_direction, require_rules
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

EXPERT_KINDS = ("adaptive", "static")
EXPERT_STRATEGIES = ("paper", "upstream", "to_stop")


@dataclass(frozen=True)
class Expert:
    """The experts of a category.

    Attributes:
        adaptive: trial and error, without the hidden state.
        static: optimal, with the hidden state.
        sequence: the adaptive sequence in words.
        others: strategy -> alternative adaptive sequence. ``upstream``: as in the released code. ``to_stop``: turns to
            the stop, or until the final joint is free in every episode, and then tries to open.
    """

    adaptive: Callable[[Hand, Knowledge], KeyFrames]
    static: Callable[[Hand, Parts, Hidden], KeyFrames]
    sequence: str
    others: Mapping[str, TurnToOpen | locks.Locks] = field(default_factory=dict)


def _turned(style: TurnToOpen, not_before: float) -> Expert:
    """Returns the experts of a part that is turned and then opened.

    ``not_before`` is upstream's earliest try [rad]: there the narrowest range is free, at least half of the widest.
    """
    others = {"upstream": style.upstream(not_before), "to_stop": style.to_stop(2 * not_before)}
    return Expert(style.adaptive, style.static, style.sequence, others)


EXPERTS: Mapping[str, Expert] = {
    "bottle": _turned(turn_to_open.BOTTLE, 0.99875),
    "pen": _turned(turn_to_open.BOTTLE, 0.99875),
    "pressure_cooker": _turned(turn_to_open.PRESSURE_COOKER, 0.35),
    "coffee_maker": _turned(turn_to_open.COFFEE_MAKER, 0.34),
    "safe": Expert(safe.adaptive, safe.static, safe.SEQUENCE),
    "microwave": Expert(microwave.adaptive, microwave.static, microwave.SEQUENCE),
    "window": _turned(turn_to_open.WINDOW, 0.6673),
    "door": _turned(turn_to_open.DOOR, 0.44625),
    "lamp": Expert(lamp.adaptive, lamp.static, lamp.SEQUENCE),
}
COMPOSED_EXPERTS: Mapping[str, Mapping[str, Expert]] = {
    "row": {
        name: Expert(each.adaptive, each.static, locks.ROW_SEQUENCE, {"to_stop": each.to_stop})
        for name, each in locks.LOCKS_OF.items()
    },
    "changing": {
        **{
            name: Expert(each.changing, each.changing_with_sight, locks.CHANGING_SEQUENCE)
            for name, each in locks.LOCKS_OF.items()
        },
        "microwave": Expert(microwave.changing, microwave.changing_with_sight, microwave.CHANGING_SEQUENCE),
    },
}
"""Experts for mechanism rules that need others: rules -> category -> expert."""


def make_expert(
    category: str,
    kind: str,
    annotations: Mapping[str, PartAnnotation],
    *,
    generator: np.random.Generator,
    trials: int = 1,
    hidden: Hidden | None = None,
    strategy: str = "paper",
    mechanism_rules: str = DEFAULT_MECHANISM_RULES,
    positions: Mapping[str, float] | None = None,
    feedback: Feedback | None = None,
    belief: Belief | None = None,
) -> KeyFrames:
    """Returns an expert, not yet primed.

    Args:
        category: ``bottle`` ... ``lamp``.
        kind: ``adaptive`` (observation and history only) or ``static`` (with sight of the hidden state).
        annotations: part poses in the robot's base frame, joints at zero.
        generator: random numbers of the expert's choices.
        trials: failed pulls at a part that is held (at a lamp: tries of a motion) before the adaptive expert does
            something else, at least 1.
        hidden: the hidden state; the static expert needs it, the adaptive one refuses it.
        strategy: ``paper``, or a key of `Expert.others`; ``paper`` if the category lacks it. For the adaptive expert.
        mechanism_rules: rules of the environment; some have experts of their own, see `COMPOSED_EXPERTS`. An adaptive
            expert knows a direction that they fix for all episodes.
        positions: joint -> position at the start [rad or m], as a camera sees it; default at rest.
        feedback: feedback at the start, if the hand may hold or touch a part. The expert then continues from there.
        belief: results of tries made before this expert took over.

    Raises:
        ConfigurationError: unknown name, too few trials, or a hidden state that is missing or not allowed.
    """
    require_choice("category", category, EXPERTS)
    expert = COMPOSED_EXPERTS.get(require_rules(category, mechanism_rules), EXPERTS)[category]
    hand = Hand(generator, trials, dict(positions or {}), belief=belief or Belief())
    _check_knowledge(require_choice("expert", kind, EXPERT_KINDS), trials, hidden)
    require_choice("expert strategy", strategy, EXPERT_STRATEGIES)
    if hidden is not None:
        return _started(hand, annotations, feedback, expert.static(hand, annotations, hidden))
    known = Knowledge(annotations, fixed_direction(category, mechanism_rules))
    return _started(hand, annotations, feedback, expert.others.get(strategy, expert).adaptive(hand, known))


def _check_knowledge(kind: str, trials: int, hidden: Hidden | None) -> None:
    """Raises `ConfigurationError` unless the static expert has the hidden state and the adaptive one does not."""
    if kind == "static" and hidden is None:
        raise ConfigurationError(
            "The static expert needs the hidden state.", got=None, allowed="a mapping", hint="env.hidden_state()"
        )
    if kind == "adaptive" and (hidden is not None or trials < 1):
        got = "a hidden state" if hidden is not None else f"trials={trials}"
        raise ConfigurationError(
            "Not an adaptive expert.", got=got, allowed="hidden=None, trials >= 1", hint="kind='static'"
        )


def _started(hand: Hand, parts: Parts, feedback: Feedback | None, frames: KeyFrames) -> KeyFrames:
    if feedback is not None:
        hand.feedback, hand.home, hand.parts = feedback, feedback.tcp_in_base.copy(), parts
    yield from frames


__all__ = [
    "EXPERTS", "EXPERT_KINDS", "EXPERT_STRATEGIES", "Belief", "Expert", "Feedback", "Goal", "KeyFrames", "Outcome",
    "Phase", "make_expert",
]  # fmt: skip
