"""Scripted experts: generators of key frames that receive what the robot felt, and branch on it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import numpy as np

from lerobot_adamanip.errors import ConfigurationError, require_choice
from lerobot_adamanip.experts import lamp, microwave, safe, turn_to_open
from lerobot_adamanip.keyframes import Feedback, Goal, KeyFrames, Outcome, Phase
from lerobot_adamanip.objects import PartAnnotation

EXPERT_KINDS = ("adaptive", "static")
EXPERT_PRESETS = ("paper", "upstream")
_TURN_TO_OPEN = turn_to_open.TURN_TO_OPEN
_ADAPTIVE: dict[str, Callable[..., KeyFrames]] = {
    "safe": safe.adaptive,
    "microwave": microwave.adaptive,
    "lamp": lamp.adaptive,
    **{name: functools.partial(turn_to_open.adaptive, style) for name, style in _TURN_TO_OPEN.items()},
}
_STATIC: dict[str, Callable[..., KeyFrames]] = {
    "safe": safe.static,
    "microwave": microwave.static,
    "lamp": lamp.static,
    **{name: functools.partial(turn_to_open.static, style) for name, style in _TURN_TO_OPEN.items()},
}
SEQUENCES = {
    "safe": safe.SEQUENCE,
    "microwave": microwave.SEQUENCE,
    "lamp": lamp.SEQUENCE,
    **{name: style.sequence for name, style in _TURN_TO_OPEN.items()},
}
"""What the adaptive expert of a category does, in words."""


def make_expert(
    category: str,
    kind: str,
    annotations: Mapping[str, PartAnnotation],
    *,
    generator: np.random.Generator,
    trials: int = 1,
    hidden: Mapping[str, bool | int | float] | None = None,
    preset: str = "paper",
) -> KeyFrames:
    """Returns an expert at work.

    Args:
        category: ``bottle`` ... ``lamp``.
        kind: ``adaptive`` (observation and history only) or ``static`` (with sight of the hidden state).
        annotations: part poses in the robot's base frame.
        generator: decides what the expert leaves to chance.
        trials: failed tries the adaptive expert makes before it changes its mind, at least 1.
        hidden: the hidden state, for the static expert alone; the adaptive one refuses it.
        preset: ``paper``, or ``upstream`` for the adaptive sequence of its released code where that differs.
    """
    require_choice("category", category, _ADAPTIVE)
    if require_choice("expert", kind, EXPERT_KINDS) == "static":
        if hidden is None:
            raise ConfigurationError(
                "The static expert needs the hidden state.", got=None, allowed="a mapping", hint="env.hidden_state()"
            )
        return _STATIC[category](annotations, generator, hidden=hidden)
    if hidden is not None or trials < 1:
        got = "a hidden state" if hidden is not None else f"trials={trials}"
        raise ConfigurationError(
            "Not an adaptive expert.", got=got, allowed="hidden=None, trials >= 1", hint="kind='static'"
        )
    if require_choice("expert preset", preset, EXPERT_PRESETS) == "upstream" and category in _TURN_TO_OPEN:
        return turn_to_open.adaptive(turn_to_open.upstream(category), annotations, generator, trials=trials)
    return _ADAPTIVE[category](annotations, generator, trials=trials)


__all__ = [
    "EXPERT_KINDS",
    "EXPERT_PRESETS",
    "SEQUENCES",
    "Feedback",
    "Goal",
    "KeyFrames",
    "Outcome",
    "Phase",
    "make_expert",
]
