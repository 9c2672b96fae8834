"""Which split's scenes an evaluation started by LeRobot uses: its trainings validate, everything else tests."""

from __future__ import annotations

import sys
from types import FrameType

from lerobot_adamanip.errors import require_choice
from lerobot_adamanip.seeds import SPLITS

AUTO = "auto"
_TRAINING = ("lerobot.configs.train", "TrainPipelineConfig")
"""Module and class of the configuration that whoever trains with LeRobot holds."""


def resolve_split(split: str) -> str:
    """Returns a split of `SPLITS` for an option: ``auto`` is ``validation`` inside a training, else ``test``.

    ``lerobot-train`` and ``lerobot-eval`` both seed their evaluations from 1000 and build environments from the same
    configuration, and tell it nothing. So this looks who is asking: a caller, however far up, that holds LeRobot's
    ``TrainPipelineConfig`` is a training, in whatever way it was started (command, ``accelerate``, a script).

    Raises:
        ConfigurationError: no such split.
    """
    require_choice("split of scenes", split, (AUTO, *SPLITS), hint="--env.split=auto")
    if split != AUTO:
        return split
    return "validation" if _inside_training(sys._getframe(1)) else "test"


def _inside_training(frame: FrameType | None) -> bool:
    """Whether a function that called this one, or one further up, holds a training's configuration."""
    training = getattr(sys.modules.get(_TRAINING[0]), _TRAINING[1], None)
    if training is None:
        return False
    while frame is not None:
        is_function = frame.f_locals is not frame.f_globals  # what a notebook keeps around says nothing
        if is_function and any(isinstance(value, training) for value in list(frame.f_locals.values())):
            return True
        frame = frame.f_back
    return False
