"""Select episodes: a table of each episode's values, and conditions on it like ``failed_tries>=1``.

Conditions are parsed, not executed.
"""

from __future__ import annotations

import itertools
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.catalog import category_of, object_split
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.memory import instruction_of
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.dense import is_dense_collection
from lerobot_adamanip.util.errors import ConfigurationError, listed, nearest
from lerobot_adamanip.util.json_fields import parse

if TYPE_CHECKING:
    from pandas import DataFrame

Value = bool | int | float | str
_ORDERED: Mapping[str, Callable[[Any, Any], bool]] = {
    ">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt,
}  # fmt: skip
_GRAMMAR = re.compile(r"\s*([A-Za-z_][\w.]*)\s*(==|!=|>=|<=|=|>|<)\s*(.*?)\s*", re.DOTALL)
_WORDS = {"true": True, "false": False}


# Values ---------------------------------------------------------------------------------------------------------------


def episode_values(dataset: Dataset) -> DataFrame:
    """Returns a table with one row per episode and one column per value; None is an unknown value.

    The columns are the scalar columns of ``meta/episodes`` and derived values: ``category`` and ``object_split`` (seen,
    unseen, novel) of its object, ``task``, ``key_frames`` (their number), ``recoveries`` (failed tries followed by a
    successful one, where its ``episode_record`` lists the tries), and its hidden state, for example ``hidden.locked``.
    """
    import pandas as pd

    rows = []
    for episode, own in zip(dataset.episodes, dataset.own_columns.to_pylist(), strict=True):
        plain = {name: value for name, value in own.items() if isinstance(value, Value)}
        values = {name: value for name, value in plain.items() if str(value)[:1] not in ("{", "[")}
        place = {
            "episode_index": episode.number,
            "length": episode.length,
            "task": ", ".join(dict.fromkeys(map(instruction_of, episode.tasks))),
        }
        derived = _of_object(plain.get("object_id")) | _recoveries(plain.get("episode_record"))
        rows.append({**place, **values, **derived, **_hidden(plain.get("hidden_state"))})
    table = pd.DataFrame(rows, dtype=object)
    if {schema.TRIED, schema.FAILED, schema.DONE} <= dataset.features.keys():
        table["key_frames"] = counted_labels(dataset)["key_frames"].astype(object)
    return table.where(table.notna(), None)


def counted_labels(dataset: Dataset) -> DataFrame:
    """Returns each episode's ``key_frames`` and ``success``, from its rows.

    Rows without a label count as rows without a success or an end. Tries are not counted from rows: a row may hold
    several, and a try may last several rows.
    """
    is_dense = is_dense_collection(dataset.features)
    unlabelled = {schema.SUCCESS: False, schema.DONE: False} | ({schema.OUTCOME: 0} if is_dense else {})
    rows = dataset.column_table([key for key in unlabelled if key in dataset.features]).to_pandas()
    rows = rows.assign(**{key: value for key, value in unlabelled.items() if key not in rows})
    ends = ~rows[schema.DONE].astype(bool)
    if is_dense:  # a key frame lasts several rows
        is_last = rows[schema.DONE].shift(-1, fill_value=True).astype(bool)
        ends &= (rows[schema.OUTCOME] != schema.GOES_ON) | is_last
    counts = {"key_frames": ends, "success": rows[schema.SUCCESS].astype(bool)}
    return rows.assign(**counts).groupby("episode_index")[[*counts]].sum().astype({"success": bool})


def _recoveries(text: Any) -> dict[str, int]:
    """Returns the ``recoveries`` in an ``episode_record``; nothing if it does not list its tries."""
    try:
        failed = [fails for _, _, fails in parse(text)["try_sequence"]]
        return {"recoveries": sum(before and not after for before, after in itertools.pairwise(failed))}
    except (KeyError, TypeError, ValueError):
        return {}


def _of_object(object_id: object) -> dict[str, Any]:
    if not isinstance(object_id, str):
        return {}
    try:
        return {"category": category_of(object_id), "object_split": object_split(object_id)}
    except ConfigurationError:  # an unknown object of another project's recording
        return {}


def _hidden(text: Any) -> dict[str, Value]:
    try:
        hidden = parse(text) if isinstance(text, str) else None
    except ValueError:
        return {}
    values = hidden if isinstance(hidden, Mapping) else {}
    return {f"hidden.{name}": value for name, value in values.items() if isinstance(value, Value)}


# Conditions -----------------------------------------------------------------------------------------------------------


def choose(conditions: Sequence[str], table: DataFrame) -> list[int]:
    """Returns the rows that fulfil all conditions.

    A condition is COLUMN OPERATION VALUE. For ``=`` and ``!=`` several values may follow, separated by commas; whole
    numbers may be ranges like ``0:10`` (10 excluded). An unknown value fulfils no condition.

    Raises:
        ConfigurationError: a condition's form, column or type of value is wrong, or no row fulfils all of them.
    """
    parsed = [_parse(text, table) for text in conditions]
    chosen = [
        row
        for row in range(len(table))
        if all((value := table[column].iat[row]) is not None and holds(value) for column, holds in parsed)
    ]
    if not chosen:
        raise ConfigurationError(
            "No episode fulfils the conditions.",
            got=" and ".join(conditions),
            allowed="; ".join(f"{column}: {_range(table[column])}" for column in dict(parsed)),
            hint="a less strict condition",
        )
    return chosen


def _parse(text: str, table: DataFrame) -> tuple[str, Callable[[Any], bool]]:
    """Returns the column of a condition and the test of its values."""
    match = _GRAMMAR.fullmatch(text)
    if match is None or not match[3]:
        raise ConfigurationError(
            "The condition has a wrong form.",
            got=repr(text),
            allowed="COLUMN OPERATION VALUE, operation one of =, !=, <, <=, >, >=",
            hint="--where 'failed_tries>=1'",
        )
    column, operation, value = match[1], match[2].replace("==", "="), match[3]
    kind = _kind(column, operation + value, table)

    def unfit(allowed: str) -> ConfigurationError:
        hint = f"--where '{column}={as_text(table[column].dropna().iat[0])}'"
        return ConfigurationError("The condition does not fit its column.", got=repr(text), allowed=allowed, hint=hint)

    def convert(word: str) -> Value:
        try:
            if kind is bool or (kind is float and word.lower() in _WORDS):
                return _WORDS[word.lower()]
            whole = float if kind is int and re.fullmatch(r"-?\d+\.\d*", word) else kind
            return whole(word)  # type: ignore[no-any-return]
        except (KeyError, ValueError):
            raise unfit(_range(table[column])) from None

    if operation in _ORDERED:
        if kind in (bool, str):
            raise unfit(f"= or !=, since {column} is no number")
        compare, bound = _ORDERED[operation], convert(value)
        return column, lambda cell: compare(cell, bound)
    ranges, values = [], list[Value]()
    for word in (part.strip() for part in value.split(",")):
        if kind is int and (span := re.fullmatch(r"(-?\d+):(-?\d+)", word)):
            ranges.append(range(int(span[1]), int(span[2])))
        else:
            values.append(convert(word))

    def is_one_of(cell: Any) -> bool:
        cell = as_text(cell) if kind is str else cell
        return cell in values or any(cell in span for span in ranges)

    return column, is_one_of if operation == "=" else lambda cell: not is_one_of(cell)


def _kind(column: str, rest: str, table: DataFrame) -> type:
    kinds = set(map(type, table[column].dropna())) if column in table else set()
    if not kinds:
        names = sorted(name for name in table.columns if table[name].notna().any())
        word = column.lower()
        begun = (name for name in names if name.startswith(word) or name.rpartition(".")[2].startswith(word))
        near = next(begun, None) or nearest(word, names)
        hint = f"--where '{near}{rest}'" if near else "--where 'success=true'"
        raise ConfigurationError("Episodes lack this column.", got=repr(column), allowed=", ".join(names), hint=hint)
    if len(kinds) == 1:
        return kinds.pop()
    # Merged datasets may store a value as true and as 1, or as a number and as text.
    return str if str in kinds else float


def as_text(value: Value) -> str:
    """Returns a value as it is typed in a condition."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _range(column: Any) -> str:
    """Returns the values of a column as text."""
    values: list[Any] = column.dropna().tolist()
    if all(isinstance(value, bool) for value in values):
        return "true or false" if len(set(values)) == 2 else f"always {str(values[0]).lower()}"
    if all(isinstance(value, int | float) for value in values):
        return f"{min(values):g} to {max(values):g}"
    return listed(sorted({as_text(value) for value in values}))
