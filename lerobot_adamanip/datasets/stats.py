"""Count a dataset's episodes, key frames, tries and recoveries, by category, split of objects and hidden value."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from lerobot_adamanip.catalog import object_split
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.seeds import split_of
from lerobot_adamanip.datasets.attempts import attempts_path, by_hidden_value, read_attempts
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.reading import episode_table, load_check
from lerobot_adamanip.datasets.selection import selection_path
from lerobot_adamanip.evaluation.metrics import Recovery, recovery
from lerobot_adamanip.evaluation.rates import Rate, rate, success_summary
from lerobot_adamanip.evaluation.record import EpisodeRecord, Provenance, hidden_boundaries
from lerobot_adamanip.evaluation.report import ALL, Group, group_records, groups_of, worth_showing
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import AdaManipError, DatasetError
from lerobot_adamanip.util.json_fields import integer, parse, read

RECORDED = Group("source", "recorded on a robot")
"""Group of a robot's episodes in a mixed dataset."""
_COUNTS = {"tries": schema.TRIED, "failed_tries": schema.FAILED, "success": schema.SUCCESS}
"""Episode column -> row column that it is counted from."""


@dataclass(frozen=True)
class GroupStats:
    """Counts of a group of episodes."""

    episodes: int
    labelled: int
    """Number of episodes with labels of tries; a robot's have none."""
    key_frames: int
    """Number of key frames, without the final observations."""
    tries: int
    failed_tries: int
    recovered: Rate
    """Success rate of the episodes with a failed try."""
    success: Rate


@dataclass(frozen=True)
class Attempts:
    """Attempts at the episodes of a dataset."""

    kept: Rate
    given_up: int
    """Number of requested episodes without a successful attempt."""
    hidden: Mapping[str, tuple[int, int]]
    """Hidden value -> (kept, attempted)."""


@dataclass(frozen=True)
class DatasetStats:
    """Counts of a dataset."""

    root: str
    objects: int
    rows: int
    """Number of rows, including final observations."""
    bytes: int
    late: int
    """Number of episodes that start from mid-task states."""
    lengths: Mapping[int, int]
    """Key frames of an episode -> number of episodes."""
    failures: Mapping[int, int]
    """Failed tries of an episode -> number of labelled episodes."""
    groups: Mapping[Group, GroupStats]
    """All episodes first, then groups by category, split of objects, and hidden value."""
    recovery: Recovery | None
    """Results after a failed try; None if no episode stores its tries in order."""
    attempts: Attempts | None
    """None if unknown, as for merged datasets and parts of others."""

    @property
    def overall(self) -> GroupStats:
        """All episodes."""
        return next(iter(self.groups.values()))

    def length_summary(self) -> dict[str, float]:
        """Returns smallest, median, mean and largest number of key frames of an episode."""
        each = sorted(Counter(dict(self.lengths)).elements())
        return {"min": each[0], "median": statistics.median(each), "mean": statistics.mean(each), "max": each[-1]}

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary; groups are a list of ``by``, ``name`` and their numbers."""
        plain = asdict(replace(self, groups={}))
        groups = [
            {"by": group.by, "name": group.name, **asdict(found), **success_summary(found.success)}
            for group, found in self.groups.items()
        ]
        return {**plain, "key_frames": self.length_summary(), "groups": groups}


def read_stats(root: str | Path) -> DatasetStats:
    """Counts a dataset; reads its rows only if the columns of its episodes lack the counts.

    Raises:
        DatasetError: it is missing or half written, or the columns of its episodes are invalid.
    """
    folder = Path(root).absolute()
    info = load_check(folder)
    try:
        rows = _with_counts(episode_table(folder).to_pylist(), folder, info["features"])
        records = [_record(row) for row in rows]
        attempts = _attempts(folder)
    except (OSError, ValueError, KeyError, TypeError, AdaManipError) as error:
        raise DatasetError(
            "The dataset has invalid values.",
            got=f"{folder.name}: {error}",
            allowed="columns as `adamanip collect` writes them",
            hint=f"adamanip check {root}",
        ) from error
    told = [record for record in records if record.try_sequence]
    return DatasetStats(
        root=str(folder),
        objects=len({record.object_id for record in records if record.object_id}),
        rows=sum(int(row["length"]) for row in rows),
        bytes=files.tree_bytes(folder),
        late=sum(bool(row.get("late")) for row in rows),
        lengths=dict(sorted(Counter(int(row["length"]) - 1 for row in rows).items())),
        failures=dict(sorted(Counter(int(row["failed_tries"]) for row in rows if _is_labelled(row)).items())),
        groups=_groups(rows, records),
        recovery=recovery(told) if told else None,
        attempts=attempts,
    )


def _groups(rows: Sequence[Mapping[str, Any]], records: Sequence[EpisodeRecord]) -> dict[Group, GroupStats]:
    """Counts all episodes, then groups of simulated episodes, then a robot's."""
    known = [record for record in records if record.object_id]
    boundaries = hidden_boundaries(known)
    # All demonstrations have seeds of the same split of scenes.
    shown = [group for group in worth_showing(group_records(known, boundaries)) if group.by not in ("all", "scenes")]
    found: dict[Group, list[Mapping[str, Any]]] = {ALL: list(rows), **{group: [] for group in shown}}
    for row, record in zip(rows, records, strict=True):
        for group in groups_of(record, boundaries) if record.object_id else [RECORDED] if known else []:
            if group == RECORDED or group in shown:
                found.setdefault(group, []).append(row)
    return {group: _count(mine) for group, mine in found.items()}


def _is_labelled(row: Mapping[str, Any]) -> bool:
    return row.get("recorded") is None


def _count(rows: Sequence[Mapping[str, Any]]) -> GroupStats:
    failing = [row for row in rows if row["failed_tries"] > 0]
    return GroupStats(
        episodes=len(rows),
        labelled=sum(map(_is_labelled, rows)),
        key_frames=sum(int(row["length"]) - 1 for row in rows),
        tries=sum(int(row["tries"]) for row in rows),
        failed_tries=sum(int(row["failed_tries"]) for row in rows),
        recovered=rate(sum(bool(row["success"]) for row in failing), len(failing)),
        success=rate(sum(bool(row["success"]) for row in rows), len(rows)),
    )


def _record(row: Mapping[str, Any]) -> EpisodeRecord:
    """Returns an episode's record from its columns, with the sequence of its tries if it is stored."""
    identifier, seed = str(row.get("object_id") or ""), int(row.get("seed") or 0)
    try:
        tries = EpisodeRecord.from_json(parse(row.get("episode_record") or "null")).try_sequence
    except ValueError:
        tries = ()
    return EpisodeRecord(
        seed=seed,
        given_seed=seed,
        split=split_of(seed),
        object_id=identifier,
        object_split=object_split(identifier) if identifier else None,
        hidden_state=parse(row.get("hidden_state") or "{}"),
        success=bool(row["success"]),
        key_frames=int(row["length"]) - 1,
        max_key_frames=int(row["length"]) - 1,
        clipped_goals=0,
        max_failed_tries=None,
        poses="randomized",
        try_sequence=tries,
        provenance=Provenance(int(row.get("simulation_version") or 0), "", "paper"),
    )


def _with_counts(
    rows: Sequence[Mapping[str, Any]], folder: Path, features: Mapping[str, Any]
) -> Sequence[Mapping[str, Any]]:
    """Returns the columns of episodes; counts missing ``tries``, ``failed_tries`` and ``success`` from the rows."""
    if all(row.get(name) is not None for row in rows for name in _COUNTS):
        return rows
    wanted = {name: key for name, key in _COUNTS.items() if key in features}
    table = pq.read_table(sorted((folder / "data").glob("*/*.parquet")), columns=["episode_index", *wanted.values()])
    episodes = table["episode_index"].to_numpy()
    counts = {name: np.zeros(len(rows), int) for name in _COUNTS}
    for name, key in wanted.items():
        values = table[key].to_numpy()
        np.add.at(counts[name], episodes, values >= 0 if name == "tries" else values)
    known = ({name: value for name, value in row.items() if value is not None or name not in _COUNTS} for row in rows)
    return [{**{name: int(each[number]) for name, each in counts.items()}, **row} for number, row in enumerate(known)]


def _attempts(folder: Path) -> Attempts | None:
    path = attempts_path(folder)
    if not path.exists() or selection_path(folder).exists():
        return None
    listed = read_attempts(path)
    content = read(manifest_path(folder)) if manifest_path(folder).exists() else {}
    given_up = integer(0, 10**9)("given_up", (content.get("attempts") or {}).get("given_up", 0))
    kept = rate(sum(attempt.kept for attempt in listed), len(listed))
    return Attempts(kept, given_up, by_hidden_value(listed))
