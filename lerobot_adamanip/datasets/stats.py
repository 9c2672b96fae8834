"""Count a dataset's episodes, key frames, tries and recoveries, by category, split of objects and hidden value."""

from __future__ import annotations

import contextlib
import statistics
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.datasets.attempts import attempts_path, grouped_by_hidden_value, read_attempts
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.conditions import counted_labels, episode_values
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.dense import is_dense_collection
from lerobot_adamanip.datasets.opening import as_typed
from lerobot_adamanip.datasets.selection import selection_path
from lerobot_adamanip.evaluation.failed_tries import FailedTries, failed_tries_by_kind
from lerobot_adamanip.evaluation.metrics import Recovery, recovery
from lerobot_adamanip.evaluation.rates import Rate, rate, success_summary
from lerobot_adamanip.evaluation.record import EpisodeRecord, hidden_boundaries, hidden_names
from lerobot_adamanip.evaluation.report import ALL, OBJECT_SPLITS, Group, worth_showing
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import AdaManipError, DatasetError
from lerobot_adamanip.util.json_fields import integer, parse, read

if TYPE_CHECKING:
    from pandas import DataFrame

RECORDED = Group("source", "recorded on a robot")
"""Group of a robot's episodes in a mixed dataset."""
KINDS = ("all", "category", "objects", "category and objects", "hidden", RECORDED.by)
"""Kinds of groups, in their order."""


@dataclass(frozen=True)
class GroupStats:
    """Counts of a group of episodes.

    Attributes:
        labelled: number of episodes with counts of tries; a robot's have none.
        key_frames: number of key frames, without the final observations.
        recovered: success rate of the episodes with a failed try.
    """

    episodes: int
    labelled: int
    key_frames: int
    tries: int
    failed_tries: int
    recovered: Rate
    success: Rate


@dataclass(frozen=True)
class Attempts:
    """Attempts at the episodes of a dataset.

    Attributes:
        kept: share of the attempts that the dataset holds.
        given_up: number of requested episodes without a successful attempt.
        hidden: hidden value -> (kept, attempted).
    """

    kept: Rate
    given_up: int
    hidden: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class DatasetStats:
    """Counts of a dataset.

    Attributes:
        rows: number of rows, including final observations.
        late: number of episodes that start from mid-task states.
        lengths: key frames of an episode -> number of episodes.
        steps: steps of an episode at control rate -> number of episodes; empty for key frames.
        fps: steps per second.
        failures: failed tries of an episode -> number of labelled episodes.
        groups: all episodes first, then groups by category, split of objects, and hidden value.
        failed_by_kind: category -> kind of try -> number of failed ones, where episodes store their tries in order.
        recovery: results after a failed try; None if no episode stores its tries in order.
        attempts: None if unknown, as for merged datasets and parts of others.
    """

    root: str
    objects: int
    rows: int
    bytes: int
    late: int
    lengths: Mapping[int, int]
    steps: Mapping[int, int]
    fps: int
    failures: Mapping[int, int]
    groups: Mapping[Group, GroupStats]
    failed_by_kind: FailedTries
    recovery: Recovery | None
    attempts: Attempts | None

    @property
    def overall(self) -> GroupStats:
        """All episodes."""
        return self.groups[ALL]

    def length_summary(self) -> dict[str, float]:
        """Returns smallest, median, mean and largest number of key frames of an episode."""
        return _summary(self.lengths)

    def step_summary(self) -> dict[str, float]:
        """Returns the same of the steps at control rate; empty for key frames."""
        return _summary(self.steps) if self.steps else {}

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary; groups are a list of ``by``, ``name`` and their numbers."""
        plain = asdict(replace(self, groups={}))
        groups = [
            {"by": group.by, "name": group.name, **asdict(stats), **success_summary(stats.success)}
            for group, stats in self.groups.items()
        ]
        return {**plain, "key_frames": self.length_summary(), "step_summary": self.step_summary(), "groups": groups}


def _summary(counts: Mapping[int, int]) -> dict[str, float]:
    lengths = sorted(Counter(dict(counts)).elements())
    middle = {"median": statistics.median(lengths), "mean": statistics.mean(lengths)}
    return {"min": lengths[0], **middle, "max": lengths[-1]}


def read_stats(root: str | Path) -> DatasetStats:
    """Counts a dataset, from the columns of its episodes; key frames, and success where they lack it, from its rows.

    Raises:
        DatasetError: it is missing or half written, or the columns of its episodes are invalid.
    """
    dataset = Dataset(root)
    try:
        table, records, is_dense = _table(dataset), episode_records(dataset), is_dense_collection(dataset.features)
        return DatasetStats(
            root=str(dataset.root),
            objects=int(table["object_id"].nunique()),
            rows=int(table["length"].sum()),
            bytes=files.tree_bytes(dataset.root),
            late=sum(late is True for late in table["late"]),
            lengths=dict(sorted(Counter(table["key_frames"].tolist()).items())),
            steps=dict(sorted(Counter((table["length"] - 1).tolist()).items())) if is_dense else {},
            fps=dataset.fps,
            failures=dict(sorted(Counter(table["failed_tries"][table["labelled"]].tolist()).items())),
            groups={group: _count(episodes) for group, episodes in _groups(table).items()},
            failed_by_kind=failed_tries_by_kind(records),
            recovery=recovery(records) if records else None,
            attempts=_attempts(dataset),
        )
    except (OSError, ValueError, KeyError, TypeError, AdaManipError) as error:
        raise DatasetError(
            "The dataset has invalid values.",
            got=f"{dataset.root.name}: {error}",
            allowed="columns as `adamanip collect` writes them",
            hint=f"adamanip check {as_typed(dataset.root)}",
        ) from error


def _table(dataset: Dataset) -> DataFrame:
    """Returns `episode_values` with counts in every episode, and ``labelled``: whether its tries are counted."""
    import pandas as pd

    table, labels = episode_values(dataset), counted_labels(dataset)
    counts = {"tries": int, "failed_tries": int}
    for name in ("object_id", "category", "object_split", "late", "success", *counts):
        table[name] = table[name] if name in table else pd.Series([None] * len(table), dtype=object)
    key_frames = labels["key_frames"] if is_dense_collection(dataset.features) else table["length"] - 1
    table = table.assign(
        labelled=table[[*counts]].notna().all(axis=1),
        key_frames=key_frames,
        success=table["success"].where(table["success"].notna(), labels["success"]),
        **{name: table[name].where(table[name].notna(), 0) for name in counts},
    )
    return table.astype({**counts, "success": bool, "length": int, "key_frames": int})


def _groups(table: DataFrame) -> dict[Group, DataFrame]:
    """Returns group -> its episodes: all, then simulated ones by category, split and hidden value, then a robot's.

    Continuous hidden values are halved at their median.
    """
    rows = table.to_dict("records")
    hidden = [name for name in table.columns if name.startswith("hidden.")]
    states = [{name.removeprefix("hidden."): row[name] for name in hidden if row[name] is not None} for row in rows]
    boundaries = hidden_boundaries((str(row["category"]), state) for row, state in zip(rows, states, strict=True))
    of_episodes = []
    for row, state in zip(rows, states, strict=True):
        groups, category, split = [ALL], row["category"], row["object_split"] or "external"
        if category is not None:
            groups += [Group("category", category), Group("objects", split)]
            groups += [Group("category and objects", f"{category}, {split}")]
            groups += [Group("hidden", f"{category}: {name}") for name in hidden_names(category, state, boundaries)]
        elif table["category"].notna().any():
            groups += [RECORDED]
        of_episodes.append(groups)
    whole = table.assign(group=of_episodes).explode("group")

    def order(group: Group) -> tuple[int, int, str]:
        return (KINDS.index(group.by), (*OBJECT_SPLITS, group.name).index(group.name), group.name)

    return {
        group: whole[whole["group"] == group] for group in sorted(worth_showing(whole["group"].unique()), key=order)
    }


def _count(table: DataFrame) -> GroupStats:
    failing = table[table["failed_tries"] > 0]
    return GroupStats(
        episodes=len(table),
        labelled=int(table["labelled"].sum()),
        key_frames=int(table["key_frames"].sum()),
        tries=int(table["tries"].sum()),
        failed_tries=int(table["failed_tries"].sum()),
        recovered=rate(int(failing["success"].sum()), len(failing)),
        success=rate(int(table["success"].sum()), len(table)),
    )


def episode_records(dataset: Dataset) -> list[EpisodeRecord]:
    """Returns the valid records of episodes with tries."""
    records = []
    for episode in dataset.episodes:
        with contextlib.suppress(ValueError):
            records.append(EpisodeRecord.from_json(parse(episode.row.get("episode_record") or "null")))
    return [record for record in records if record.try_sequence]


def _attempts(dataset: Dataset) -> Attempts | None:
    folder, path = dataset.root, attempts_path(dataset.root)
    if not path.exists() or selection_path(folder).exists():
        return None
    attempts = read_attempts(path)
    seeds = set(dataset.table["seed"].to_pylist())
    if seeds.isdisjoint(each.seed for each in attempts if each.kept):  # the failed ones, whose list is the other's
        return None
    content = read(manifest_path(folder)) if manifest_path(folder).exists() else {}
    given_up = integer(0, 10**9)("given_up", (content.get("attempts") or {}).get("given_up", 0))
    groups = grouped_by_hidden_value(attempts).items()
    hidden = {label: (sum(each.kept for each in group), len(group)) for label, group in groups}
    return Attempts(rate(sum(each.kept for each in attempts), len(attempts)), given_up, hidden)
