"""What comes of an item of a collection, and how it is written."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lerobot_adamanip.datasets.collection_spec import CollectionPaths, EpisodeSpec
from lerobot_adamanip.datasets.shards import write_shard_bytes
from lerobot_adamanip.util import files

Hidden = Mapping[str, Any]


@dataclass(frozen=True)
class Attempt:
    """One episode that was tried.

    Attributes:
        seed: of the episode.
        hidden_state: its draw; None if there was no layout to draw it for.
        success: whether the expert succeeded.
        reason: ``success``, or why not.
        key_frames: it took.
        late: whether it started late.
    """

    seed: int
    hidden_state: Hidden | None
    success: bool
    reason: str
    key_frames: int
    late: bool


@dataclass(frozen=True)
class ItemReport:
    """What became of an item.

    Attributes:
        attempts: at it.
        kept: whether the last one is in an episode file: a success, or a policy's episode, however it ended.
    """

    attempts: tuple[Attempt, ...] = field(default=())
    kept: bool = False


@dataclass(frozen=True)
class ItemOutcome:
    """A report, and what is to be written with it.

    Attributes:
        report: the result of the item.
        failed: attempt -> file content of failed episodes that are to be kept.
        episode: file content of the episode to keep; None if the item was given up.
    """

    report: ItemReport
    failed: Mapping[int, bytes] = field(default_factory=dict)
    episode: bytes | None = None


def write_outcome(paths: CollectionPaths, item: EpisodeSpec, outcome: ItemOutcome) -> None:
    """Writes the result of an item, durably; what makes it count as done comes last."""
    for number, content in sorted(outcome.failed.items()):
        name = item.file_name.replace(".safetensors", f"-{number:03d}.safetensors")
        write_shard_bytes(paths.failed_episodes / name, content)
    if outcome.episode is not None:
        write_shard_bytes(paths.episodes / item.file_name, outcome.episode)
    else:
        write_given_up(paths, item, list(outcome.report.attempts))


def write_given_up(paths: CollectionPaths, item: EpisodeSpec, attempts: list[Attempt]) -> None:
    """Keeps account of an item at which all attempts failed."""
    content = json.dumps([vars(attempt) for attempt in attempts], sort_keys=True)
    files.write_atomically(paths.attempts / item.file_name.replace(".safetensors", ".json"), content.encode())


def read_given_up(paths: CollectionPaths, item: EpisodeSpec) -> list[Attempt]:
    """Returns the attempts at an item that was given up; none if there is no account of it."""
    path = paths.attempts / item.file_name.replace(".safetensors", ".json")
    try:
        return [Attempt(**attempt) for attempt in json.loads(path.read_text())]
    except (OSError, ValueError, TypeError):
        return []
