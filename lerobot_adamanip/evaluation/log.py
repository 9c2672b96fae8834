"""Episode log (``--env.episode_log=FILE``): one `EpisodeRecord` per JSON line, appended by many processes."""

from __future__ import annotations

import json
import logging
import uuid
from pathlib import Path

from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.util import files, json_fields
from lerobot_adamanip.util.errors import DatasetError, listed


def new_run_id() -> str:
    """Returns a random id for one evaluation, shared by all its processes."""
    return uuid.uuid4().hex[:12]


def append_record(path: Path, record: EpisodeRecord) -> None:
    """Appends a record as one line; creates the folder if needed. Raises `DatasetError` if it cannot be written."""
    try:
        files.append_line(path, json.dumps(record.to_json()))
    except OSError as error:
        raise DatasetError(
            "An episode cannot be added to the episode log.",
            got=f"{path}: {error.strerror}",
            allowed="a file that can be written, on a disk with free space",
            hint="--env.episode_log=FILE on another disk",
        ) from error


def read_log(path: Path) -> list[EpisodeRecord]:
    """Reads a log. Skips lines that are cut off or not JSON, and logs a warning that names them.

    Raises:
        DatasetError: the log is missing, holds no episode, or was written by another version.
    """
    advice = f"lerobot-eval --env.type=adamanip_safe --env.episode_log={path} ..."
    _require_file(path)
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        raise DatasetError(
            "Cannot read the episode log.", got=f"{path}: {error}", allowed="a file of JSON lines", hint=advice
        ) from error
    records, damaged = list[EpisodeRecord](), list[int]()
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            records.append(EpisodeRecord.from_json(json_fields.parse(line)))
        except json.JSONDecodeError:
            damaged.append(number)
        except ValueError as error:
            raise DatasetError(
                "This is no episode log of this version.",
                got=f"{path}, line {number}: {error}",
                allowed="one record per line, as the environments of this version write",
                hint=f"evaluate again: {advice}",
            ) from error
    if not records:
        what = "This is no episode log." if damaged else "The episode log is empty."
        raise DatasetError(what, got=path, allowed="at least one episode, as a line of JSON", hint=advice)
    if damaged:
        logging.getLogger(__name__).warning(
            "%s: skipped damaged lines (%s); their episodes are not counted", path, listed(damaged)
        )
    return records


def _require_file(path: Path) -> None:
    if path.is_dir():
        dataset = (path / "meta").is_dir()
        raise DatasetError(
            "This is a dataset, not an episode log." if dataset else "This is a folder, not an episode log.",
            got=path,
            allowed="a file that lerobot-eval --env.episode_log=FILE wrote",
            hint=f"adamanip stats {path}" if dataset else f"a file in {path}",
        )
