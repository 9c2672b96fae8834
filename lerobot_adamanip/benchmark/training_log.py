"""What the log of `lerobot-train` says about a training: its number of parameters and its loss."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from lerobot_adamanip.util.json_fields import integer, listing, number

LOGGED = 20
"""Number of values of the loss in a training's log."""
_PARAMETERS = re.compile(r"num_learnable_params=(\d+)")
_LOSS = re.compile(r" loss:([-+.\deE]+) ")
_LATEST = LOGGED // 5


@dataclass(frozen=True, kw_only=True)
class TrainingLog:
    """A training that ran without an interruption.

    Attributes:
        parameters: number of learnable parameters.
        losses: mean training loss of each of `LOGGED` equal parts of the training, in order.
    """

    parameters: Annotated[int, integer(0, 10**12)]
    losses: Annotated[tuple[float, ...], listing(number(-1e12, 1e12), LOGGED, LOGGED)]

    @property
    def change(self) -> float:
        """Relative change of the loss from the last but one fifth of the training to the last; negative if it falls."""
        before, latest = self.losses[-2 * _LATEST : -_LATEST], self.losses[-_LATEST:]
        return sum(latest) / sum(before) - 1 if sum(before) else 0.0


def read_training_log(path: Path) -> TrainingLog | None:
    """Returns the training in a log; None if it was interrupted, or if LeRobot has changed the form of its log."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    parameters, losses = _PARAMETERS.findall(text), [float(each) for each in _LOSS.findall(text)]
    if len(parameters) != 1 or len(losses) != LOGGED:
        return None
    return TrainingLog(parameters=int(parameters[0]), losses=tuple(losses))
