"""Named values of each episode, for selecting and splitting episodes."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from lerobot_adamanip.catalog import category_of, object_split
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.conditions import Facts, Value
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.json_fields import parse


def episode_facts(source: Dataset) -> list[Facts]:
    """Returns each episode's values, by name.

    These are the scalar columns of ``meta/episodes`` and derived values: ``category`` and ``object_split`` (seen,
    unseen, novel) of its object, ``task``, ``key_frames`` (number of actions), ``recoveries`` (failed tries followed by
    a successful one), and its hidden state, for example ``hidden.locked``.
    """
    counted = _counted(source)
    lengths, tasks = (source.table[name].to_pylist() for name in ("length", "tasks"))
    facts: list[dict[str, Value | None]] = []
    for number, row in enumerate(source.own_columns.to_pylist()):
        plain = {name: value for name, value in row.items() if isinstance(value, bool | int | float | str)}
        texts = {name: value for name, value in plain.items() if str(value)[:1] not in ("{", "[")}
        facts.append(
            {
                "episode_index": number,
                "length": lengths[number],
                "task": ", ".join(tasks[number]),
                **texts,
                **_of_object(plain.get("object_id")),
                **_hidden(plain.get("hidden_state")),
                **counted[number],
            }
        )
    names = dict.fromkeys(name for each in facts for name in each)
    return [{name: each.get(name) for name in names} for each in facts]


def _of_object(identifier: object) -> dict[str, Value | None]:
    if not isinstance(identifier, str):
        return {}
    try:
        return {"category": category_of(identifier), "object_split": object_split(identifier)}
    except ConfigurationError:  # an unknown object of another project's recording
        return {}


def _hidden(text: Any) -> dict[str, Value | None]:
    try:
        values = parse(text) if isinstance(text, str) else None
    except ValueError:
        return {}
    found = values if isinstance(values, Mapping) else {}
    return {f"hidden.{name}": value for name, value in found.items() if isinstance(value, bool | int | float | str)}


def _counted(source: Dataset) -> list[dict[str, Value | None]]:
    """Returns values counted from each episode's rows; empty if the columns of tries are missing."""
    wanted = ["episode_index", schema.TRIED, schema.FAILED, schema.DONE]
    if not set(wanted) <= set(source.features):
        return [{} for _ in range(len(source))]
    rows = source.column_table(wanted).to_pandas()
    return [
        {
            "key_frames": int((~mine[schema.DONE]).sum()),
            "recoveries": recoveries(mine.loc[mine[schema.TRIED] >= 0, schema.FAILED].tolist()),
        }
        for _, mine in rows.groupby("episode_index")
    ]


def recoveries(failed: Sequence[bool]) -> int:
    """Returns how many failed tries are directly followed by a successful one."""
    return sum(one and not following for one, following in itertools.pairwise(failed))
