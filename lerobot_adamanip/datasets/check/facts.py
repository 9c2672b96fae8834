"""Check the columns of episodes, and the collection's files: manifest and attempts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.versions import mixed_versions
from lerobot_adamanip.datasets.attempts import attempts_path, read_attempts
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.collection_spec import episode_seed, manifest_path
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.episode import EpisodeDescription
from lerobot_adamanip.datasets.manifest import Manifest, are_same_versions, read_manifest
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
        return Collected(manifest, manifest.versions)
    except AdaManipError as error:
        cause = "" if error.__cause__ is None else f" {error.__cause__}"[:200]
        report.add("collection", str(error).partition("\n")[0] + cause, COLLECTION)
    except (OSError, ValueError, KeyError, TypeError) as error:
        report.add("unreadable", str(error)[:200], COLLECTION)
    return None


def has_facts(dataset: Dataset) -> bool:
    """Returns whether the dataset has this project's episode columns."""
    return {"object_id", "tries"} <= set(dataset.table.column_names)


def check_facts(dataset: Dataset, collected: Collected | None, successes: Mapping[int, bool], report: Report) -> None:
    """Checks the columns of episodes for valid values, against success in their rows, and against the collection."""
    if not has_facts(dataset):
        return
    # Corrections of a policy use the seeds of demonstrations, so actions are compared to find an episode that is twice.
    name, stored = f"stats/{schema.ACTION}/mean", dataset.statistics
    means = stored[name].to_pylist() if name in stored.column_names else [None] * len(dataset.table)
    seen: dict[tuple[object, ...], int] = {}
    for row, mean in zip(dataset.table.to_pylist(), means, strict=True):
        number, place = row["episode_index"], (row["listed_in"], row["episode_index"])
        if any(row.get(name) is not None for name in ("object_id", "seed", "hidden_state")):  # a robot's has none
            try:
                _check_row(row)
                if successes.get(number, row["success"]) != row["success"] and number not in report.damaged:
                    raise ValueError(f"success is {row['success']}, but the rows say {successes[number]}")
                if collected is not None:
                    for column, check in (("slot", _COUNT), ("attempt", _COUNT), ("late", flag)):
                        check(column, row.get(column))
                    _check_place(row, collected, report)
            except (ValueError, TypeError, KeyError, AdaManipError) as error:
                report.add("facts", str(error).partition("\n")[0][:200], *place)
        if number not in report.damaged:
            same = seen.setdefault((row["object_id"], row.get("seed"), row["length"], str(mean)), number)
            if same != number:
                report.add("facts", f"it equals episode {same}", *place)
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
    spec, object_id = collected.manifest.spec, row["object_id"]
    if object_id not in spec.objects:
        report.add("collection", f"{object_id} is not an object of the collection", *place)
    elif row["seed"] != episode_seed(spec.seed, category_of(object_id), object_id, row["slot"], row["attempt"]):
        report.add("collection", f"seed {row['seed']} does not follow from its place in the collection", *place)


def _check_attempts(root: Path, collected: Collected, report: Report) -> None:
    """Checks that the list of attempts has as many lines as the manifest counts."""
    try:
        attempted = len(read_attempts(attempts_path(root)))
    except AdaManipError as error:
        is_missing = isinstance(error.__cause__, FileNotFoundError)
        message = "the attempts of the collection" if is_missing else str(error.__cause__)[:200]
        report.add("missing" if is_missing else "unreadable", message, ATTEMPTS)
        return
    counts = None if collected.manifest is None else collected.manifest.attempts
    if counts is not None and attempted != counts.attempted:
        report.add("attempts", f"{attempted} lines, where {COLLECTION} counts {counts.attempted}", ATTEMPTS)
