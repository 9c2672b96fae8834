"""Which split's scenes an evaluation started by LeRobot uses: its trainings validate, everything else tests."""

from __future__ import annotations

from lerobot_adamanip.errors import require_choice
from lerobot_adamanip.seeds import SPLITS
from lerobot_env_adamanip.caller import TRAINING, held_by_callers

AUTO = "auto"


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
    return "validation" if any(True for _ in held_by_callers(config, TRAINING)) else "test"
