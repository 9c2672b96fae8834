"""The card of a dataset with episodes of a robot, alone or mixed with simulated ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.datasets.cards.collected import common_fields
from lerobot_adamanip.datasets.cards.templates import card_template
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import parse

RECORDED = "recorded"
"""Column of episodes: source recording of a robot's episode, as JSON."""


def has_recorded_episodes(root: Path) -> bool:
    """Returns whether a dataset contains episodes of a robot."""
    table = Dataset(root, recordings=True).table
    return RECORDED in table.column_names and table[RECORDED].null_count < len(table)


def recorded_card(folder: Path, name: str, repo_id: str) -> str:
    """Returns the README of a dataset with episodes of a robot, given its folder's name and its name on the Hub.

    Raises:
        DatasetError: an episode has neither its recording nor its object.
    """
    dataset = Dataset(folder)
    rows = dataset.table.to_pylist()
    try:
        sources = Counter(map(_source, rows))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(
            "The episodes do not say how they were made.",
            got=f"{folder.name}: {type(error).__name__} {error}"[:400],
            allowed="the columns that `adamanip keyframes` writes into meta/episodes",
            hint="adamanip keyframes RECORDING --out DATASET",
        ) from error
    return card_template("recorded_card.md").substitute(
        common_fields(dataset.info, name, repo_id, len(rows)),
        successes=sum(bool(row.get("success")) for row in rows),
        sources="\n".join(f"| {count} | {source} |" for source, count in sources.items()),
    )


def _source(row: Mapping[str, Any]) -> str:
    """Returns table cells with the source of an episode, and whether its tries are labelled."""
    if row.get(RECORDED) is None:
        return f"simulated, {category_of(row['object_id']).replace('_', ' ')} | yes"
    told = parse(row[RECORDED])
    corrections = ", corrections of a policy" if told.get("corrections") else ""
    return f"robot `{told['robot_type']}`, recording `{told['recording']}`{corrections} | no"
