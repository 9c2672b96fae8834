"""Check the columns of episodes, and the collection's files: manifest, attempts, cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets import is_asset_id, parse_asset_id
from lerobot_adamanip.catalog import category_of, parse_object_id
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.versions import mixed_versions
from lerobot_adamanip.datasets.attempts import attempts_path, read_attempts
from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.check.layout import ATTEMPTS, Layout
from lerobot_adamanip.datasets.collection_spec import CollectionSpec, episode_seed, manifest_path
from lerobot_adamanip.datasets.manifest import HIDDEN_STATE, Manifest, are_same_versions, read_manifest
from lerobot_adamanip.datasets.reading import JSON_COLUMNS
from lerobot_adamanip.datasets.start_column import read_start
from lerobot_adamanip.hardware.features import UNLABELLED
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.json_fields import flag, integer, mapping, optional, parse, read, text

COLLECTION = "meta/collection.json"
Row = Mapping[str, Any]
"""Column values of an episode."""
_ANY = text(r"(?s).*", "text")
_VALUES = mapping(_ANY, lambda _, value: value, 64)
_COUNT = integer(0, 2**31)
_SEED = integer(0, 2**63 - 1)


@dataclass(frozen=True)
class Collected:
    """Collection that a dataset comes from.

    Attributes:
        manifest: None if the folder of its external assets is unknown.
        versions: name -> version of the software.
    """

    manifest: Manifest | None
    versions: Mapping[str, str]


def read_collection(root: Path, assets: Path | None, report: Report) -> Collected | None:
    """Reads ``meta/collection.json``; returns None if there is none (merged dataset) or it is invalid (a finding)."""
    path = manifest_path(root)
    if not path.exists():
        return None
    try:
        content = read(path)
        external = isinstance(content, dict) and bool(content.get("external_assets"))
        if external and assets is None:
            return Collected(None, dict(content["versions"]))
        manifest = read_manifest(path, assets if external else None)
    except AdaManipError as error:
        cause = "" if error.__cause__ is None else f" {error.__cause__}"[:200]
        report.add("collection", str(error).partition("\n")[0] + cause, COLLECTION)
    except (OSError, ValueError, KeyError, TypeError) as error:
        report.add("unreadable", str(error)[:200], COLLECTION)
    else:
        return Collected(manifest, manifest.versions)
    return None


def count_labels(where: Rows, columns: Mapping[str, NDArray[Any]]) -> dict[int, dict[str, int]]:
    """Returns episode -> ``success``, read from its rows. Tries are not counted there: one may last several rows."""
    if schema.SUCCESS not in columns:
        return {number: {} for number, _ in where.runs()}
    return {number: {"success": int(np.any(columns[schema.SUCCESS][rows]))} for number, rows in where.runs()}


def check_course(where: Rows, columns: Mapping[str, NDArray[Any]], report: Report) -> None:
    """Checks recorded episodes: failed tries count up, success stays, and only the last row ends the episode.

    Applies to datasets with episode columns (`check_facts`): `EpisodeRecorder` writes both.
    """
    starts = where.starts()
    first = np.zeros(len(where), bool)
    first[starts] = True
    if schema.DONE in columns:
        wrong = columns[schema.DONE].astype(bool) != np.r_[first[1:], True]
        report.add_rows("label", f"{schema.DONE} is not true in the last row only", where, wrong)
    if schema.SUCCESS in columns:
        success = columns[schema.SUCCESS].astype(np.int8)
        wrong = ~first & (np.diff(success, prepend=success[:1]) < 0)
        report.add_rows("label", f"{schema.SUCCESS} turns false again", where, wrong)
    if schema.TRIAL in columns:
        trial = columns[schema.TRIAL].astype(np.int64)
        wrong = np.where(first, trial != 0, np.diff(trial, prepend=trial[:1]) < 0) & (trial != UNLABELLED)
        report.add_rows("label", f"{schema.TRIAL} does not count failed tries up from 0", where, wrong)


def has_facts(layout: Layout) -> bool:
    """Returns whether the dataset has this project's episode columns."""
    return {"object_id", "tries"} <= set(layout.table.column_names)


def check_facts(
    layout: Layout, collected: Collected | None, counted: Mapping[int, Mapping[str, int]], report: Report
) -> None:
    """Checks the columns of episodes for valid values, against counts of the rows, and against the collection."""
    if not has_facts(layout):
        return
    names = [name for name in layout.table.column_names if not name.startswith("stats/")]
    rows = layout.table.select(names).to_pylist()
    for row in rows:
        if row["object_id"] is None and row.get("recorded") is not None:
            continue  # an episode of a robot in a mixed dataset: no object, no seed
        number = row["episode_index"]
        try:
            _check_row(row)
            for name, value in counted.get(number, {}).items():
                if name in row and int(row[name]) != value and number not in report.damaged:
                    raise ValueError(f"{name} is {row[name]}, but the rows say {value}")
            if collected is not None:
                for name in ("slot", "attempt"):
                    _COUNT(name, row.get(name))
                flag("late", row.get("late"))
        except (ValueError, TypeError, KeyError, AdaManipError) as error:
            report.add("facts", str(error).partition("\n")[0][:200], row["listed_in"], number)
            continue
        if collected is not None:
            _check_place(row, collected, report)
    _check_once(layout, rows, report)
    if collected is not None:
        _check_attempts(layout.root, collected, report)


def _check_row(row: Row) -> None:
    """Raises ValueError for invalid values."""
    object_id = text(r".{1,120}", "an object's id")("object_id", row["object_id"])
    (parse_asset_id if is_asset_id(object_id) else parse_object_id)(object_id)
    _SEED("seed", row.get("seed"))
    flag("success", row.get("success"))
    if _COUNT("failed_tries", row.get("failed_tries")) > _COUNT("tries", row.get("tries")):
        raise ValueError(f"failed_tries = {row['failed_tries']} of tries = {row['tries']}")
    parsed = {name: parse(_ANY(name, row[name])) for name in JSON_COLUMNS if name in row}
    HIDDEN_STATE("hidden_state", parsed["hidden_state"])
    optional(HIDDEN_STATE)("hidden_overrides", parsed.get("hidden_overrides"))
    if "start" in row:
        actions = read_start(_ANY("start", row["start"]))
        if "late" in row and flag("late", row["late"]) != bool(len(actions)):
            raise ValueError(f"late is {row['late']}, but start tells of {len(actions)} actions")
    told = _VALUES("episode_record", parsed.get("episode_record", {}))
    if "try_sequence" in told:
        failed = [fails for _, _, fails in told["try_sequence"]]
        if (row["tries"], row["failed_tries"]) != (len(failed), sum(failed)):
            counts = f"{row['failed_tries']} of {row['tries']} tries failed"
            raise ValueError(f"{counts}, but episode_record says {sum(failed)} of {len(failed)}")
    own = {"object_id": object_id, "seed": row["seed"], "hidden_state": parsed["hidden_state"]}
    for name, value in own.items():
        if name in told and told[name] != value:
            raise ValueError(f"{name} is {value!r:.60}, but episode_record says {told[name]!r:.60}")


def _check_place(row: Row, collected: Collected, report: Report) -> None:
    """Checks an episode's versions, object and seed against its collection."""
    place = row["listed_in"], row["episode_index"]
    versions = parse(row["versions"]) if "versions" in row else collected.versions
    if not are_same_versions(versions, collected.versions):
        mixed = mixed_versions([versions, collected.versions]) if isinstance(versions, dict) else "no versions"
        report.add("versions", f"not the collection's: {mixed or 'some are missing'}"[:200], *place)
    if collected.manifest is None:
        return
    spec: CollectionSpec = collected.manifest.spec
    name = row["object_id"]
    if name not in spec.objects:
        report.add("collection", f"{name} is not an object of the collection", *place)
    elif row["seed"] != episode_seed(spec.seed, category_of(name), name, row["slot"], row["attempt"]):
        report.add("collection", f"seed {row['seed']} does not follow from its place in the collection", *place)


def _check_once(layout: Layout, rows: Sequence[Row], report: Report) -> None:
    """Reports duplicate episodes, from a collection or a seed that was merged with itself."""
    name = f"stats/{schema.ACTION}/mean"
    means = layout.table[name].to_pylist() if name in layout.table.column_names else [None] * len(rows)
    seen: dict[tuple[object, ...], int] = {}
    for row, mean in zip(rows, means, strict=True):
        number = row["episode_index"]
        if number not in report.damaged:
            # Corrections of a policy use the seeds of demonstrations, so the actions are compared too.
            same = seen.setdefault((row["object_id"], row.get("seed"), row["length"], str(mean)), number)
            if same != number:
                report.add("facts", f"it equals episode {same}", row["listed_in"], number)


def _check_attempts(root: Path, collected: Collected, report: Report) -> None:
    """Checks that the list of attempts has as many lines as the manifest counts."""
    try:
        attempted = len(read_attempts(attempts_path(root)))
    except AdaManipError as error:
        is_missing = isinstance(error.__cause__, FileNotFoundError)
        told = "the attempts of the collection" if is_missing else str(error.__cause__)[:200]
        report.add("missing" if is_missing else "unreadable", told, ATTEMPTS)
        return
    counts = None if collected.manifest is None else collected.manifest.attempts
    if counts is not None and attempted != counts.attempted:
        report.add("attempts", f"{attempted} lines, where {COLLECTION} counts {counts.attempted}", ATTEMPTS)
