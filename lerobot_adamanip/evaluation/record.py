"""The episode log that environments append (``--env.episode_log=FILE``): one JSON object per line and episode."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.assets import parse_asset_id
from lerobot_adamanip.catalog import category_of, is_asset_id, object_split, parse_object_id
from lerobot_adamanip.errors import AdaManipError, DatasetError


@dataclass(frozen=True)
class EpisodeRecord:
    """One episode, as the environment's monitor wrote it.

    Attributes:
        seed: decided object, poses and hidden state.
        object_id: ``safe_007``.
        hidden: hidden state as drawn, as sorted (name, value) pairs.
        success: whether it was opened.
        key_frames: steps it took.
        first_part: part that was held first, or None.
        blocked_pulls: tries at what opens (door, lid, button of a lamp) that were blocked.
        key_moved: whether the key (knob, button, cap, lever) was moved.
        wrong_turns: turns of the key that were blocked from the start.
    """

    seed: int
    object_id: str
    hidden: tuple[tuple[str, Any], ...]
    success: bool
    key_frames: int
    first_part: str | None
    blocked_pulls: int
    key_moved: bool
    wrong_turns: int

    @property
    def locked(self) -> bool | None:
        """Whether it started locked; None in a category that always has to be turned first."""
        return dict(self.hidden).get("locked")

    @property
    def category(self) -> str:
        """Kind of object."""
        return category_of(self.object_id)

    @property
    def unseen(self) -> bool | None:
        """Whether the object is none of those that demonstrations are collected on; None of an external asset."""
        if is_asset_id(self.object_id):
            return None
        return object_split(self.object_id) != "seen"

    @property
    def identity(self) -> tuple[object, ...]:
        """What makes it the same episode as another."""
        return (self.seed, self.object_id, self.hidden)


def parse_record(content: Any) -> EpisodeRecord:
    """Returns the record in a decoded line; raises ValueError that names what is wrong with it."""
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")
    hidden = _typed(content, "hidden_state", dict)
    if "locked" in hidden:
        _typed(hidden, "locked", bool)
    object_id = _typed(content, "object_id", str)
    try:
        (parse_asset_id if is_asset_id(object_id) else parse_object_id)(object_id)
    except AdaManipError:
        raise ValueError(f"unknown object_id {object_id!r}") from None
    first_part = content.get("first_part")
    return EpisodeRecord(
        seed=_typed(content, "seed", int),
        object_id=object_id,
        hidden=tuple(sorted(hidden.items())),
        success=_typed(content, "success", bool),
        key_frames=_typed(content, "key_frames", int),
        first_part=None if first_part is None else _typed(content, "first_part", str),
        blocked_pulls=_typed(content, "blocked_pulls", int),
        key_moved=_typed(content, "key_moved", bool),
        wrong_turns=_typed(content, "wrong_turns", int),
    )


def _typed(content: dict[str, Any], key: str, kind: type) -> Any:
    if key not in content:
        raise ValueError(f"no {key!r}")
    # bool is an int to Python, but a count of True is garbage.
    if not isinstance(content[key], kind) or (kind is int and isinstance(content[key], bool)):
        raise ValueError(f"{key!r} is {content[key]!r}, not of type {kind.__name__}")
    return content[key]


def read_log(path: Path) -> list[EpisodeRecord]:
    """Reads a log.

    Raises:
        DatasetError: it is missing, empty, or a line of it is not an episode's record.
    """
    advice = f"lerobot-eval --env.type=adamanip_safe --env.episode_log={path} ..."
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
            records.append(parse_record(json.loads(line)))
        except ValueError as error:
            raise DatasetError(
                "The episode log is garbled.",
                got=f"{path}, line {number}: {error}",
                allowed="one JSON object per line, as the environments write",
                hint=f"delete line {number}, or {advice}",
            ) from error
    if not records:
        raise DatasetError("The episode log is empty.", got=path, allowed="at least one episode", hint=advice)
    return records
