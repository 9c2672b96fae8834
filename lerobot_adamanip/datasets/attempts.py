"""All attempts at a dataset's episodes, kept or not (``meta/attempts.jsonl``), and groups of them by hidden value."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, EpisodeSpec
from lerobot_adamanip.datasets.episode import HIDDEN_STATE, EpisodeDescription
from lerobot_adamanip.datasets.manifest import AttemptCounts
from lerobot_adamanip.evaluation.record import hidden_boundaries, hidden_names
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import DatasetError

SUCCESS = "success"
"""Reason of an attempt that succeeded."""
NO_LAYOUT = "(no layout)"
"""Hidden state of an attempt without a reachable layout."""


@dataclass(frozen=True)
class AttemptRecord:
    """One line of ``meta/attempts.jsonl``.

    Attributes:
        object_id, slot, attempt: its place: attempt number, from 0, at the object's episode number ``slot``.
        seed: seed of the episode.
        hidden_state: hidden values of the episode; None if there was no layout.
        kept: whether the dataset contains it.
        reason: ``success``, or the reason of the failure.
        key_frames: number of them, or of steps at control rate.
        late: whether it started from a mid-task state.
    """

    object_id: str
    slot: int
    attempt: int
    seed: int
    hidden_state: Mapping[str, Any] | None
    kept: bool
    reason: str
    key_frames: int
    late: bool

    @property
    def success(self) -> bool:
        """Whether it succeeded; corrected episodes of a policy are also kept without success."""
        return self.reason == SUCCESS


def all_attempts(
    paths: CollectionPaths, items: Iterable[EpisodeSpec], records: Iterable[Mapping[str, Any]]
) -> list[AttemptRecord]:
    """Returns all attempts at the items, in order, including those of given-up items."""
    kept = {(record["slot"], record["object_id"]): record for record in records}
    attempts = []
    for item in items:
        if record := kept.get((item.slot, item.object_id)):
            reason = SUCCESS if record["success"] else "corrected without success"
            key_frames = record["episode_record"]["key_frames"]
            tried = [*record["failures"], {**record, "key_frames": key_frames, "reason": reason}]
        else:
            path = paths.attempts / item.file_name.replace(".safetensors", ".json")
            tried = json_fields.read(path) if path.exists() else []
        for number, attempt in enumerate(tried):
            facts = {key: attempt[key] for key in ("seed", "hidden_state", "reason", "key_frames", "late")}
            in_dataset = record is not None and number == len(tried) - 1
            attempts.append(AttemptRecord(item.object_id, item.slot, number, kept=in_dataset, **facts))
    return attempts


def attempts_path(root: Path) -> Path:
    """Returns the path of a dataset's list of attempts."""
    return root / "meta" / "attempts.jsonl"


def attempts_jsonl(attempts: Iterable[AttemptRecord]) -> bytes:
    """Returns attempts as lines of JSON."""
    return "".join(json.dumps(vars(attempt), sort_keys=True) + "\n" for attempt in attempts).encode()


def read_attempts(path: Path) -> list[AttemptRecord]:
    """Reads ``meta/attempts.jsonl``; raises `DatasetError` if it is missing or has an invalid line."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        return [AttemptRecord(**_ATTEMPT("an attempt", json_fields.parse(line))) for line in lines]
    except (OSError, ValueError) as error:
        raise DatasetError(
            "Cannot read the list of attempts.",
            got=f"{path.name}: {error}",
            allowed="the file `adamanip collect` wrote",
            hint="another folder",
        ) from error


def count(attempts: list[AttemptRecord], wanted: int) -> AttemptCounts:
    """Returns the numbers of attempts and kept attempts for ``wanted`` episodes."""
    kept = sum(attempt.kept for attempt in attempts)
    return AttemptCounts(kept, len(attempts), wanted - kept)


def grouped_by_hidden_value[Item: AttemptRecord | EpisodeDescription](items: Iterable[Item]) -> dict[str, list[Item]]:
    """Returns ``safe: locked`` -> attempts or episodes; each is listed under every one of its hidden values.

    Continuous values are split at their category's median. Those without a layout come last.
    """
    known = [(category_of(item.object_id), item.hidden_state, item) for item in items]
    boundaries = hidden_boundaries((category, hidden) for category, hidden, _ in known if hidden is not None)
    groups: dict[str, list[Item]] = {}
    for category, hidden, item in known:
        names = [NO_LAYOUT] if hidden is None else hidden_names(category, hidden, boundaries)
        for name in names:
            groups.setdefault(f"{category}: {name}", []).append(item)
    return dict(sorted(groups.items(), key=lambda group: (NO_LAYOUT in group[0], group[0])))


_COUNT = json_fields.integer(0, 2**31)
_LINE = json_fields.text(r"[^\r\n|`]{1,500}", "one line")
_FIELDS: Mapping[str, json_fields.Check] = {
    "object_id": _LINE, "slot": _COUNT, "attempt": _COUNT, "seed": _COUNT,
    "hidden_state": json_fields.optional(HIDDEN_STATE), "kept": json_fields.flag, "reason": _LINE,
    "key_frames": _COUNT, "late": json_fields.flag,
}  # fmt: skip
_ATTEMPT = json_fields.table(_FIELDS)
