"""What is in a dataset: episodes, key frames, tries and recoveries, by category, split of objects and hidden value."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pyarrow.parquet as pq

from lerobot_adamanip.catalog import object_split
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.seeds import split_of
from lerobot_adamanip.datasets.attempts import attempts_path, by_hidden_value, read_attempts
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.reading import episode_table, load_check
from lerobot_adamanip.datasets.selection import selection_path
from lerobot_adamanip.evaluation.groups import ALL, Group, group_records, groups_of, hidden_boundaries, worth_showing
from lerobot_adamanip.evaluation.rates import Rate, rate, success_summary
from lerobot_adamanip.evaluation.record import EpisodeRecord, Provenance
from lerobot_adamanip.evaluation.tries import Recovery, recovery
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import AdaManipError, DatasetError
from lerobot_adamanip.util.json_fields import integer, parse, read

RECORDED = Group("source", "recorded on a robot")
"""Episodes of a mix that tell no object of ours."""


@dataclass(frozen=True)
class GroupContents:
    """Episodes that have something in common.

    Attributes:
        episodes: how many.
        labelled: of those, how many tell their tries; a robot's episodes do not.
        key_frames: in all; an episode's last row, the final observation, is none.
        tries: at a joint.
        failed_tries: of those.
        recovered: of the episodes in which a try failed, those that ended in success.
        success: of the episodes.
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
    """What was tried for the dataset.

    Attributes:
        kept: attempts that are episodes of it, of all.
        given_up: episodes that were asked for, and no attempt at them succeeded.
        hidden: what was hidden -> (kept, attempted).
    """

    kept: Rate
    given_up: int
    hidden: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class Contents:
    """What is in a dataset.

    Attributes:
        root: of it.
        objects: how many different ones.
        rows: in all, final observations counted.
        bytes: of all files.
        late: episodes that start late.
        lengths: key frames of an episode -> episodes.
        failures: failed tries of an episode -> episodes, of those that tell their tries.
        groups: all episodes first, then by category, split of objects, and hidden value.
        recovery: what follows a try that failed; None where no episode tells its tries in order.
        attempts: that were made for it; None if it does not say, as merged datasets and parts of others do not.
    """

    root: str
    objects: int
    rows: int
    bytes: int
    late: int
    lengths: Mapping[int, int]
    failures: Mapping[int, int]
    groups: Mapping[Group, GroupContents]
    recovery: Recovery | None
    attempts: Attempts | None

    @property
    def overall(self) -> GroupContents:
        """All episodes."""
        return next(iter(self.groups.values()))

    def length_summary(self) -> dict[str, float]:
        """Returns smallest, median, mean and largest number of key frames of an episode."""
        each = sorted(Counter(dict(self.lengths)).elements())
        return {"min": each[0], "median": statistics.median(each), "mean": statistics.mean(each), "max": each[-1]}

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary; groups as a list of ``by``, ``name`` and their numbers."""
        plain = asdict(replace(self, groups={}))
        groups = [
            {"by": group.by, "name": group.name, **asdict(found), **success_summary(found.success)}
            for group, found in self.groups.items()
        ]
        return {**plain, "key_frames": self.length_summary(), "groups": groups}


def contents(root: str | Path) -> Contents:
    """Counts what is in a dataset; rows are not read where its episodes have the counts as columns.

    Raises:
        DatasetError: it is not there, or half written, or tells of an episode what cannot be.
    """
    folder = Path(root).absolute()
    info = load_check(folder)
    rows = episode_table(folder).to_pylist()
    try:
        facts = _with_counts(rows, folder, info["features"])
        records = [_record(row) for row in facts]
        attempts = _attempts(folder)
    except (OSError, ValueError, KeyError, TypeError, AdaManipError) as error:
        raise DatasetError(
            "The dataset tells what cannot be.",
            got=f"{folder.name}: {error}",
            allowed="columns as `adamanip collect` writes them",
            hint=f"adamanip check {root}",
        ) from error
    told = [record for record in records if record.try_sequence]
    return Contents(
        root=str(folder),
        objects=len({record.object_id for record in records if record.object_id}),
        rows=sum(int(row["length"]) for row in rows),
        bytes=files.tree_bytes(folder),
        late=sum(bool(row.get("late")) for row in rows),
        lengths=_tally(int(row["length"]) - 1 for row in rows),
        failures=_tally(int(row["failed_tries"]) for row in facts if _is_labelled(row)),
        groups=_groups(facts, records),
        recovery=recovery(told) if told else None,
        attempts=attempts,
    )


def _tally(values: Iterable[int]) -> dict[int, int]:
    return dict(sorted(Counter(values).items()))


def _groups(rows: Sequence[Mapping[str, Any]], records: Sequence[EpisodeRecord]) -> dict[Group, GroupContents]:
    """Counts all episodes, then by group those that tell their object, and then a robot's, which do not."""
    known = [record for record in records if record.object_id]
    boundaries = hidden_boundaries(known)
    # All seeds of demonstrations are of one split of scenes.
    shown = [group for group in worth_showing(group_records(known, boundaries)) if group.by not in ("all", "scenes")]
    found: dict[Group, list[Mapping[str, Any]]] = {ALL: list(rows), **{group: [] for group in shown}}
    for row, record in zip(rows, records, strict=True):
        own = groups_of(record, boundaries) if record.object_id else [RECORDED] if known else []
        for group in own:
            if group == RECORDED:
                found.setdefault(RECORDED, []).append(row)
            elif group in shown:
                found[group].append(row)
    return {group: _count(mine) for group, mine in found.items()}


def _is_labelled(row: Mapping[str, Any]) -> bool:
    """Whether an episode tells its tries: nobody has labelled those that a robot recorded."""
    return row.get("recorded") is None


def _count(rows: Sequence[Mapping[str, Any]]) -> GroupContents:
    failing = [row for row in rows if row["failed_tries"] > 0]
    return GroupContents(
        episodes=len(rows),
        labelled=sum(map(_is_labelled, rows)),
        key_frames=sum(int(row["length"]) - 1 for row in rows),
        tries=sum(int(row["tries"]) for row in rows),
        failed_tries=sum(int(row["failed_tries"]) for row in rows),
        recovered=rate(sum(bool(row["success"]) for row in failing), len(failing)),
        success=rate(sum(bool(row["success"]) for row in rows), len(rows)),
    )


def _record(row: Mapping[str, Any]) -> EpisodeRecord:
    """Returns what an episode was, as its columns tell, with its tries in order where its record has them."""
    identifier = str(row.get("object_id") or "")
    return EpisodeRecord(
        seed=int(row.get("seed") or 0),
        given_seed=int(row.get("seed") or 0),
        split=split_of(int(row.get("seed") or 0)),
        object_id=identifier,
        object_split=object_split(identifier) if identifier else None,
        hidden_state=parse(row.get("hidden_state") or "{}"),
        success=bool(row["success"]),
        key_frames=int(row["length"]) - 1,
        tries=int(row["tries"]),
        blocked_pulls=int(row["failed_tries"]),
        wrong_turns=0,
        key_moved=False,
        first_part=None,
        first_try_failed=False,
        try_sequence=_sequence(row),
        provenance=Provenance(str(row.get("fingerprint") or ""), "", "paper"),
    )


def _sequence(row: Mapping[str, Any]) -> tuple[tuple[int, int, bool], ...]:
    try:
        return EpisodeRecord.from_json(parse(row.get("episode_record") or "null")).try_sequence
    except ValueError:
        return ()


def _with_counts(
    rows: Sequence[Mapping[str, Any]], folder: Path, features: Mapping[str, Any]
) -> list[Mapping[str, Any]]:
    """Returns the columns of episodes; ``tries``, ``failed_tries``, ``success`` that are unknown come from the rows."""
    names = ("tries", "failed_tries", "success")
    if all(row.get(name) is not None for row in rows for name in names):
        return list(rows)
    counted = _counted(folder, features)
    known = ({name: value for name, value in row.items() if value is not None or name not in names} for row in rows)
    return [{**counted[row["episode_index"]], **row} for row in known]


def _counted(folder: Path, features: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """Returns what the rows of each episode count, for datasets whose episodes do not have it as columns."""
    wanted = [key for key in (schema.TRIED, schema.FAILED, schema.SUCCESS) if key in features]
    table = pq.read_table(sorted((folder / "data").glob("*/*.parquet")), columns=["episode_index", *wanted])
    if schema.TRIED in wanted:
        at = table.schema.get_field_index(schema.TRIED)
        table = table.set_column(at, schema.TRIED, pc.greater_equal(table[schema.TRIED], 0))
    summed = table.group_by("episode_index").aggregate([(key, "sum") for key in wanted]).to_pylist()
    return {
        int(row["episode_index"]): {
            "tries": int(row.get(f"{schema.TRIED}_sum", 0)),
            "failed_tries": int(row.get(f"{schema.FAILED}_sum", 0)),
            "success": bool(row.get(f"{schema.SUCCESS}_sum", 0)),
        }
        for row in summed
    }


def _attempts(folder: Path) -> Attempts | None:
    path = attempts_path(folder)
    if not path.exists() or selection_path(folder).exists():
        return None
    listed = read_attempts(path)
    content = read(manifest_path(folder)) if manifest_path(folder).exists() else {}
    given_up = integer(0, 10**9)("given_up", (content.get("attempts") or {}).get("given_up", 0))
    kept = rate(sum(attempt.kept for attempt in listed), len(listed))
    return Attempts(kept, given_up, by_hidden_value(listed))
