"""The card of a dataset with episodes that a robot has recorded, alone or mixed with simulated ones."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.datasets.cards.collected import card_header, features_table
from lerobot_adamanip.datasets.cards.templates import card_template, citation, front_matter
from lerobot_adamanip.datasets.reading import episode_table
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import parse

RECORDED = "recorded"
"""Column of episodes: the recording that a robot's episode was cut from, as JSON."""


def has_recorded_episodes(root: Path) -> bool:
    """Whether a robot has recorded any of a dataset's episodes."""
    table = episode_table(root)
    return RECORDED in table.column_names and table[RECORDED].null_count < len(table)


def recorded_card(folder: Path, name: str, repo_id: str) -> str:
    """Returns the README of a dataset that a robot has recorded, or some episodes of it.

    Args:
        folder: that the dataset is in.
        name: that its folder will have.
        repo_id: its name on the Hub.

    Raises:
        DatasetError: an episode tells neither its recording nor its object.
    """
    info = json.loads((folder / "meta" / "info.json").read_text(encoding="utf-8"))
    rows = episode_table(folder).to_pylist()
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
        front_matter=front_matter("dataset", card_header(info, name)),
        episodes=len(rows),
        frames=info["total_frames"],
        key_frames=info["total_frames"] - len(rows),
        successes=sum(bool(row.get("success")) for row in rows),
        sources="\n".join(f"| {count} | {source} |" for source, count in sources.items()),
        repo_id=repo_id,
        fps=info["fps"],
        features=features_table(info["features"]),
        citation=citation(),
    )


def _source(row: Mapping[str, Any]) -> str:
    """Returns what made an episode, and whether its tries are labelled, as cells of a table."""
    if row.get(RECORDED) is None:
        return f"simulated, {category_of(row['object_id']).replace('_', ' ')} | yes"
    told = parse(row[RECORDED])
    corrections = ", corrections of a policy" if told.get("corrections") else ""
    return f"robot `{told['robot_type']}`, recording `{told['recording']}`{corrections} | no"
