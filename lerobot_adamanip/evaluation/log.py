"""Episode log (``--env.episode_log=FILE``): one `EpisodeRecord` per JSON line, appended by many processes."""

from __future__ import annotations

import json
import uuid
from pathlib import Path

from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.util import files, json_fields
from lerobot_adamanip.util.errors import DatasetError


def new_run_id() -> str:
    """Returns a random id for one evaluation, shared by all its processes."""
    return uuid.uuid4().hex[:12]


def append_record(path: Path, record: EpisodeRecord) -> None:
    """Appends a record as one line; creates the folder if needed."""
    files.append_line(path, json.dumps(record.to_json()))


def read_log(path: Path) -> list[EpisodeRecord]:
    """Reads a log.

    Raises:
        DatasetError: the log is missing or empty, or a line is not a valid record.
    """
    advice = f"lerobot-eval --env.type=adamanip_safe --env.episode_log={path} ..."
    if path.is_dir():
        dataset = (path / "meta").is_dir()
        raise DatasetError(
            "This is a dataset, not an episode log." if dataset else "This is a folder, not an episode log.",
            got=path,
            allowed="a file that lerobot-eval --env.episode_log=FILE wrote",
            hint=f"adamanip stats {path}" if dataset else f"a file in {path}",
        )
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(
            "Cannot read the episode log.", got=f"{path}: {error}", allowed="a file of JSON lines", hint=advice
        ) from error
    records = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            records.append(EpisodeRecord.from_json(json_fields.parse(line)))
        except ValueError as error:
            raise DatasetError(
                "The episode log is garbled, or was written by another version.",
                got=f"{path}, line {number}: {error}",
                allowed="one JSON object per line, as the environments of this version write",
                hint=f"delete line {number}, or {advice}",
            ) from error
    if not records:
        raise DatasetError("The episode log is empty.", got=path, allowed="at least one episode", hint=advice)
    return records
