"""Reading the episode log: what the environment writes is read; what it does not, is one clear error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lerobot_adamanip.errors import DatasetError
from lerobot_adamanip.evaluation.record import read_log

GOOD: dict[str, Any] = {
    "seed": 1000, "object_id": "safe_003", "hidden_state": {"locked": True, "direction": -1, "knob_range": 1.2},
    "success": True, "key_frames": 19, "first_part": "handle", "blocked_pulls": 1, "key_moved": True,
    "wrong_turns": 0, "joints": {"door": 0.5, "knob": 1.1}, "category": "safe",
}  # fmt: skip


def write(path: Path, *lines: object) -> Path:
    path.write_text("\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines) + "\n")
    return path


def test_records_come_back_in_order(tmp_path: Path) -> None:
    path = write(tmp_path / "log.jsonl", GOOD, "", {**GOOD, "seed": 1001, "object_id": "safe_036", "first_part": None})
    first, second = read_log(path)
    assert (first.seed, first.locked, first.unseen, first.blocked_pulls) == (1000, True, False, 1)
    assert (second.seed, second.unseen, second.first_part) == (1001, True, None)


@pytest.mark.parametrize("key", [key for key in GOOD if key not in ("first_part", "joints", "category")])
def test_a_record_that_lacks_something_names_line_and_key(key: str, tmp_path: Path) -> None:
    damaged = {name: value for name, value in GOOD.items() if name != key}
    with pytest.raises(DatasetError, match=rf"line 2: no '{key}'"):
        read_log(write(tmp_path / "log.jsonl", GOOD, damaged))


@pytest.mark.parametrize(
    "line",
    [
        '{"seed": 1000, "object', "[1, 2]", "text", {**GOOD, "success": "yes"}, {**GOOD, "blocked_pulls": True},
        {**GOOD, "object_id": "spoon_001"}, {**GOOD, "hidden_state": {"locked": 1}}, {**GOOD, "first_part": 3},
    ],
)  # fmt: skip
def test_garbled_lines_are_one_clear_error(line: object, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"garbled[\s\S]*line 3"):
        read_log(write(tmp_path / "log.jsonl", GOOD, GOOD, line))


def test_missing_empty_and_binary_logs_are_told(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="Cannot read"):
        read_log(tmp_path / "none.jsonl")
    with pytest.raises(DatasetError, match="Cannot read"):
        read_log(tmp_path)
    with pytest.raises(DatasetError, match="empty"):
        read_log(write(tmp_path / "empty.jsonl", ""))
    (tmp_path / "binary").write_bytes(bytes(range(128, 256)))
    with pytest.raises(DatasetError, match="Cannot read"):
        read_log(tmp_path / "binary")
