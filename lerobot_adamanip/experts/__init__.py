"""Scripted experts: generators of key frames that receive what the robot felt, and branch on it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lerobot_adamanip.errors import ConfigurationError, explain, require_choice
from lerobot_adamanip.experts.base import Feedback, Goal, KeyFrames, Outcome, Phase
from lerobot_adamanip.experts.safe import adaptive_safe, static_safe
from lerobot_adamanip.objects import PartAnnotation

EXPERT_KINDS = ("adaptive", "static")
_ADAPTIVE = {"safe": adaptive_safe}
_STATIC = {"safe": static_safe}


def make_expert(
    category: str,
    kind: str,
    annotations: Mapping[str, PartAnnotation],
    *,
    generator: np.random.Generator,
    trials: int = 1,
    hidden: Mapping[str, bool | int | float] | None = None,
) -> KeyFrames:
    """Returns an expert at work.

    Args:
        category: ``safe``.
        kind: ``adaptive`` (observation and history only) or ``static`` (with sight of the hidden state).
        annotations: part poses in the robot's base frame.
        generator: decides what the expert leaves to chance.
        trials: failed tries the adaptive expert makes before it changes its mind, at least 1.
        hidden: the hidden state, for the static expert alone; the adaptive one refuses it.
    """
    require_choice("category", category, _ADAPTIVE)
    if require_choice("expert", kind, EXPERT_KINDS) == "static":
        if hidden is None:
            raise ConfigurationError(
                explain(
                    "The static expert needs the hidden state.",
                    got=None,
                    allowed="a mapping",
                    try_="env.hidden_state()",
                )
            )
        return _STATIC[category](annotations, generator, hidden=hidden)
    if hidden is not None or trials < 1:
        got = "a hidden state" if hidden is not None else f"trials={trials}"
        raise ConfigurationError(
            explain("Not an adaptive expert.", got=got, allowed="hidden=None, trials >= 1", try_="kind='static'")
        )
    return _ADAPTIVE[category](annotations, generator, trials=trials)


__all__ = ["EXPERT_KINDS", "Feedback", "Goal", "KeyFrames", "Outcome", "Phase", "make_expert"]
