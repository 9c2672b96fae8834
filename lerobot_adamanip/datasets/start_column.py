"""Column ``start`` of an episode: at rest, or the actions before the recording starts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.json_fields import listing, number, parse, table

RESET = "reset"
"""Value of an episode that starts at rest."""
_MAX_ACTIONS = 64
_PREFIX = table({"actions": listing(listing(number(-10.0, 10.0), ACTION_DIM, ACTION_DIM), 1, _MAX_ACTIONS)})

Actions = NDArray[np.float32]


def start_column(actions: Actions) -> Any:
    """Returns the value of column ``start``, before its conversion to JSON: `RESET`, or the actions up to the start."""
    return {"actions": [[float(value) for value in row] for row in actions]} if len(actions) else RESET


def read_start(value: str) -> Actions:
    """Returns the (n, 10) actions in a value of column ``start``; raises ValueError for an invalid value."""
    content = parse(value)
    if content == RESET:
        return np.zeros((0, ACTION_DIM), np.float32)
    fields: Mapping[str, Any] = _PREFIX("start", content)
    return np.asarray(fields["actions"], np.float32)
