"""Description of a simulated episode in ``meta/episodes``: one dataclass, written to columns and read with checks.

`EpisodeDescription` is made where an episode is recorded. The datasets may be untrusted, so every value is checked.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets import is_asset_id, parse_asset_id
from lerobot_adamanip.catalog import parse_object_id
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.json_fields import (
    Check,
    either,
    flag,
    integer,
    listing,
    mapping,
    number,
    optional,
    parse,
    table,
    text,
)

RESET = "reset"
"""Value of ``start`` of an episode that starts at rest."""
Actions = NDArray[np.float32]
_ACTION = listing(number(-10.0, 10.0), ACTION_DIM, ACTION_DIM)
_PREFIX = table({"actions": listing(_ACTION, 1, 64)})
_TEXT = text(r"(?s).*", "text")
_COUNT = integer(0, 2**31)
_VALUES = mapping(_TEXT, lambda _, value: value, 64)
HIDDEN_STATE: Check = mapping(
    text(r"[a-z][a-z_]{0,39}", "the name of a hidden value"), either(flag, number(-1e6, 1e6), text(r"\w{1,40}", "")), 16
)
"""Checks the hidden values of an episode."""


def check_object_id(name: str, value: object) -> str:
    """Returns an object's id; raises ValueError for anything else."""
    object_id = str(text(r".{1,120}", "an object's id")(name, value))
    try:
        (parse_asset_id if is_asset_id(object_id) else parse_object_id)(object_id)
    except AdaManipError:
        raise ValueError(f"{name} is {object_id!r}, which is no object's id") from None
    return object_id


def start_column(actions: Actions) -> Any:
    """Returns the value of ``start``: `RESET`, or the actions between the reset and the first row."""
    return {"actions": [[float(value) for value in row] for row in actions]} if len(actions) else RESET


def read_start(value: object) -> Actions:
    """Returns the (n, 10) actions in a decoded value of ``start``; raises ValueError for an invalid value."""
    if value == RESET:
        return np.zeros((0, ACTION_DIM), np.float32)
    return np.asarray(_PREFIX("start", value)["actions"], np.float32)


def to_json(value: Any, indent: int | None = None) -> str:
    """Returns JSON with sorted keys, so that equal values give equal bytes."""
    return json.dumps(value, sort_keys=True, indent=indent)


@dataclass(frozen=True, kw_only=True)
class EpisodeDescription:
    """Description of a recorded episode, without its rows.

    Attributes:
        object_id: ``safe_007``.
        seed: seed of the scene.
        expert: driver of the arm: ``adaptive``, ``static``, or the name of a policy.
        tries, failed_tries: number of tries, and of the failed ones.
        success: whether the task was done.
        attempt: number of earlier attempts at this episode, which are in ``failures``.
        slot: number of the episode among those of its object.
        late: whether it starts from a mid-task state.
        simulation_version, data_version: see `lerobot_adamanip.contract.versions`.
        hidden_state: sampled values.
        hidden_overrides: hidden values that were requested at the reset; None if all were drawn.
        start: see `start_column`.
        camera: parameters of the front camera.
        versions: installed versions.
        failures: earlier attempts.
        episode_record: line of the episode log, see `lerobot_adamanip.evaluation.record`.
    """

    object_id: str
    seed: int
    expert: str
    tries: int
    failed_tries: int
    success: bool
    attempt: int = 0
    slot: int = 0
    late: bool = False
    simulation_version: int = 0
    data_version: int = 0
    hidden_state: Mapping[str, Any]
    hidden_overrides: Mapping[str, Any] | None = None
    start: Any = RESET
    camera: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    failures: Sequence[Mapping[str, Any]] = ()
    episode_record: Mapping[str, Any] = field(default_factory=dict)

    @property
    def attempts(self) -> int:
        """Number of attempts at this episode, including this one; 1 in the dataset of failed episodes."""
        return len(self.failures) + 1

    def record(self, task: str) -> dict[str, Any]:
        """Returns its fields as `RecordedEpisode.record`, with the instruction ``task``."""
        return {**vars(self), "attempts": self.attempts, "task": task}

    @classmethod
    def from_columns(cls, row: Mapping[str, Any], *, partial: bool = False) -> EpisodeDescription:
        """Returns the description in a row of ``meta/episodes``.

        Args:
            row: column -> value; other columns are ignored.
            partial: whether only the columns without a default must be there.

        Raises:
            ValueError: a column is missing, or has an invalid value.
        """
        names = [item.name for item in fields(cls) if item.name in row or not partial]
        if missing := [name for name in names if name not in row]:
            raise ValueError(f"there is no column {missing[0]}")
        values = {name: parse(_TEXT(name, row[name])) if name in JSON_COLUMNS else row[name] for name in names}
        for name, check in _CHECKS.items():
            if name in values:
                check(name, values[name])
            elif name not in _OPTIONAL:
                raise ValueError(f"there is no column {name}")
        if values["failed_tries"] > values["tries"]:
            raise ValueError(f"failed_tries = {values['failed_tries']} of tries = {values['tries']}")
        if "start" in values:
            actions = read_start(values["start"])
            if "late" in values and values["late"] != bool(len(actions)):
                raise ValueError(f"late is {values['late']}, but start has {len(actions)} actions")
        return cls(**{"expert": "", **values})


PLAIN_COLUMNS = (
    "object_id", "seed", "expert", "tries", "failed_tries", "success", "attempts", "attempt", "slot", "late",
    "simulation_version", "data_version",
)  # fmt: skip
JSON_COLUMNS = ("hidden_state", "hidden_overrides", "start", "camera", "versions", "failures", "episode_record")
"""Columns of an episode, in their order; those of `JSON_COLUMNS` hold JSON."""
_CHECKS: Mapping[str, Check] = {
    "object_id": check_object_id, "seed": integer(0, 2**63 - 1), "success": flag, "tries": _COUNT,
    "failed_tries": _COUNT, "hidden_state": HIDDEN_STATE, "hidden_overrides": optional(HIDDEN_STATE), "late": flag,
    "slot": _COUNT, "attempt": _COUNT, "episode_record": _VALUES,
}  # fmt: skip
_OPTIONAL = ("hidden_overrides", "late", "slot", "attempt", "episode_record")
