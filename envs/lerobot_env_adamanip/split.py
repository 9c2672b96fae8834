"""Which split's scenes an evaluation started by LeRobot uses: its trainings validate, everything else tests."""

from __future__ import annotations

import sys
from types import FrameType

from lerobot_adamanip.errors import require_choice
from lerobot_adamanip.seeds import SPLITS

AUTO = "auto"
_TRAINING = ("lerobot.configs.train", "TrainPipelineConfig")
"""Module and class of the configuration that whoever trains with LeRobot holds."""


def resolve_split(split: str, config: object) -> str:
    """Returns a split of `SPLITS` for an option: ``auto`` is ``validation`` inside a training, else ``test``.

    ``lerobot-train`` and ``lerobot-eval`` both seed their evaluations from 1000 and build environments from the same
    configuration, and tell it nothing. So this looks who is asking: a caller, however far up, that holds a
    ``TrainPipelineConfig`` whose ``env`` is this configuration is a training, in whatever way it was started (command,
    ``accelerate``, a script).

    Args:
        split: ``auto``, or one of `SPLITS`.
        config: the environment's configuration.

    Raises:
        ConfigurationError: no such split.
    """
    require_choice("split of scenes", split, (AUTO, *SPLITS), hint="--env.split=auto")
    if split != AUTO:
        return split
    return "validation" if _inside_training(sys._getframe(1), config) else "test"


def _inside_training(frame: FrameType | None, config: object) -> bool:
    """Whether a function that called this one, or one further up, holds the training whose environment this is."""
    training = getattr(sys.modules.get(_TRAINING[0]), _TRAINING[1], None)
    if training is None:
        return False
    while frame is not None:
        for value in list(frame.f_locals.values()):
            if isinstance(value, training) and getattr(value, "env", None) is config:
                return True
        frame = frame.f_back
    return False
