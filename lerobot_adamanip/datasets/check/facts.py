"""Check the columns of episodes, and the collection's files: manifest, attempts, cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.versions import mixed_versions
from lerobot_adamanip.datasets.attempts import attempts_path, read_attempts
from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.collection_spec import CollectionSpec, episode_seed, manifest_path
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.episode import EpisodeDescription
from lerobot_adamanip.datasets.manifest import Manifest, are_same_versions, read_manifest
from lerobot_adamanip.hardware.features import UNLABELLED
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.json_fields import flag, integer, parse, read

COLLECTION, ATTEMPTS = "meta/collection.json", "meta/attempts.jsonl"
Row = Mapping[str, Any]
"""Column values of an episode."""
_COUNT = integer(0, 2**31)


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


def has_facts(dataset: Dataset) -> bool:
    """Returns whether the dataset has this project's episode columns."""
    return {"object_id", "tries"} <= set(dataset.table.column_names)


def check_facts(
    dataset: Dataset, collected: Collected | None, counted: Mapping[int, Mapping[str, int]], report: Report
) -> None:
    """Checks the columns of episodes for valid values, against counts of the rows, and against the collection."""
    if not has_facts(dataset):
        return
    rows = dataset.table.to_pylist()
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
    _check_once(dataset, rows, report)
    if collected is not None:
        _check_attempts(dataset.root, collected, report)


def _check_row(row: Row) -> None:
    """Raises ValueError for invalid values."""
    episode = EpisodeDescription.from_columns(row, partial=True)
    record = episode.episode_record
    if "try_sequence" in record:
        failed = [fails for _, _, fails in record["try_sequence"]]
        if (episode.tries, episode.failed_tries) != (len(failed), sum(failed)):
            counts = f"{episode.failed_tries} of {episode.tries} tries failed"
            raise ValueError(f"{counts}, but episode_record says {sum(failed)} of {len(failed)}")
    for name in ("object_id", "seed", "hidden_state"):
        if name in record and record[name] != (value := getattr(episode, name)):
            raise ValueError(f"{name} is {value!r:.60}, but episode_record says {record[name]!r:.60}")


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


def _check_once(dataset: Dataset, rows: Sequence[Row], report: Report) -> None:
    """Reports duplicate episodes, from a collection or a seed that was merged with itself."""
    name, stored = f"stats/{schema.ACTION}/mean", dataset.statistics
    means = stored[name].to_pylist() if name in stored.column_names else [None] * len(rows)
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
