"""Scripted experts: generators of key frames that receive what the robot felt, and branch on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrames, Outcome, Phase
from lerobot_adamanip.experts import lamp, microwave, safe, turn_to_open
from lerobot_adamanip.experts.belief import Belief, Hidden, Knowledge, Parts
from lerobot_adamanip.experts.primitives import Hand
from lerobot_adamanip.experts.turn_to_open import TurnToOpen
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES, fixed_direction
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

EXPERT_KINDS = ("adaptive", "static")
EXPERT_STRATEGIES = ("paper", "upstream", "to_stop")


@dataclass(frozen=True)
class Expert:
    """The experts of a category.

    Attributes:
        adaptive: trial and error, without sight of the hidden state.
        static: optimal under full observation.
        sequence: what the adaptive one does, in words.
        others: strategy -> another adaptive sequence, where the category has one: ``upstream``, its released code's,
            and ``to_stop``, which turns until it feels a stop, or no episode's is farther, before it tries to open.
    """

    adaptive: Callable[[Hand, Knowledge], KeyFrames]
    static: Callable[[Hand, Parts, Hidden], KeyFrames]
    sequence: str
    others: Mapping[str, TurnToOpen] = field(default_factory=dict)


def _turned(style: TurnToOpen, not_before: float) -> Expert:
    """A row of what is turned and then opened; upstream's first try comes not before an angle [rad].

    That is where the narrowest range is free, and a range is at least half of the widest.
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
    """Returns an expert at work.

    Args:
        category: ``bottle`` ... ``lamp``.
        kind: ``adaptive`` (observation and history only) or ``static`` (with sight of the hidden state).
        annotations: part poses in the robot's base frame, joints at zero.
        generator: decides what the expert leaves to chance.
        trials: failed tries the adaptive expert makes before it changes its mind, at least 1.
        hidden: the hidden state, for the static expert alone; the adaptive one refuses it.
        strategy: of the adaptive expert: ``paper``, or one of `Expert.others` where the category has it.
        mechanism_rules: of the environment: a direction that it fixes for all episodes an adaptive expert knows.
        positions: joint -> where it stands at the start [rad or m], as a camera sees it. Left out is at rest.
        feedback: of the hand at the start, if it may hold something or be about a part: it goes on with what it wants.
        belief: what tries before this expert's own tell.

    Raises:
        ConfigurationError: an unknown name, or knowledge that this kind of expert must not have or lacks.
    """
    expert = EXPERTS[require_choice("category", category, EXPERTS)]
    hand = Hand(generator, trials, dict(positions or {}), belief=belief or Belief())
    _check_knowledge(require_choice("expert", kind, EXPERT_KINDS), trials, hidden)
    if hidden is not None:
        return _started(hand, annotations, feedback, expert.static(hand, annotations, hidden))
    known = Knowledge(annotations, fixed_direction(category, mechanism_rules))
    return _started(hand, annotations, feedback, _adaptive(expert, strategy)(hand, known))


def _adaptive(expert: Expert, strategy: str) -> Callable[[Hand, Knowledge], KeyFrames]:
    other = expert.others.get(require_choice("expert strategy", strategy, EXPERT_STRATEGIES))
    return other.adaptive if other else expert.adaptive


def _check_knowledge(kind: str, trials: int, hidden: Hidden | None) -> None:
    """Raises `ConfigurationError` unless the static expert, and it alone, is told the hidden state."""
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
