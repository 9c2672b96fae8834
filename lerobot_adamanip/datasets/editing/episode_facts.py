"""What is known of each episode of a dataset, one value a name, to choose and to part episodes by."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.catalog import category_of, object_split
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.editing.conditions import Facts, Value
from lerobot_adamanip.datasets.editing.source import Source
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.json_fields import parse

HIDDEN = "hidden."
"""Begins the names of hidden values."""
_HIDDEN_STATE, _OBJECT = "hidden_state", "object_id"


def episode_facts(source: Source) -> list[Facts]:
    """Returns what is known of each episode, by name.

    That is every column of ``meta/episodes`` that holds one plain value, and what follows from them and the rows:
    ``category`` and ``object_split`` (seen, unseen, novel) of its object, ``task``, ``key_frames`` (actions sent),
    ``recoveries`` (failed tries after which the next one worked) and the values of its hidden state, ``hidden.locked``
    for one.
    """
    told = _told_by_rows(source)
    rows = source.own_columns.to_pylist()
    lengths, tasks = (source.episodes[name].to_pylist() for name in ("length", "tasks"))
    facts: list[Facts] = []
    for number, row in enumerate(rows):
        plain = {name: value for name, value in row.items() if isinstance(value, bool | int | float | str)}
        text = plain.pop(_HIDDEN_STATE, None)
        facts.append(
            {
                "episode_index": number,
                "length": lengths[number],
                "task": ", ".join(tasks[number]),
                **{name: value for name, value in plain.items() if not _is_json(value)},
                **_of_object(plain.get(_OBJECT)),
                **_hidden(text),
                **told[number],
            }
        )
    names = dict.fromkeys(name for each in facts for name in each)
    return [{name: each.get(name) for name in names} for each in facts]


def _is_json(value: Value) -> bool:
    return isinstance(value, str) and value[:1] in ("{", "[")


def _of_object(identifier: Value | None) -> dict[str, Value | None]:
    if not isinstance(identifier, str):
        return {}
    try:
        return {"category": category_of(identifier), "object_split": object_split(identifier)}
    except ConfigurationError:  # an object of somebody else's recording
        return {}


def _hidden(text: Any) -> dict[str, Value | None]:
    try:
        values = parse(text) if isinstance(text, str) else None
    except ValueError:
        return {}
    found = values if isinstance(values, Mapping) else {}
    return {f"{HIDDEN}{name}": value for name, value in found.items() if isinstance(value, bool | int | float | str)}


def _told_by_rows(source: Source) -> list[dict[str, Value | None]]:
    """Returns what the rows say of each episode; nothing where they have not the columns of tries."""
    wanted = ["episode_index", schema.TRIED, schema.FAILED, schema.DONE]
    if not set(wanted) <= set(source.info["features"]):
        return [{} for _ in range(source.info["total_episodes"])]
    paths = sorted((source.root / "data").glob("*/*.parquet"))
    columns = pa.concat_tables([pq.read_table(path, columns=wanted) for path in paths]).to_pydict()
    tries: list[list[bool]] = [[] for _ in range(source.info["total_episodes"])]
    sent = [0] * len(tries)
    for episode, tried, failed, done in zip(*(columns[name] for name in wanted), strict=True):
        sent[episode] += not done
        if tried >= 0:
            tries[episode].append(failed)
    return [{"key_frames": count, "recoveries": recoveries(each)} for count, each in zip(sent, tries, strict=True)]


def recoveries(failed: Sequence[bool]) -> int:
    """Returns how many failed tries, in their order, are followed by one that works."""
    return sum(one and not following for one, following in itertools.pairwise(failed))
