"""Result of a collection's item, and how it is written to disk."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lerobot_adamanip.datasets.collection_spec import CollectionPaths, EpisodeSpec
from lerobot_adamanip.datasets.shards import write_shard_bytes
from lerobot_adamanip.util import files

Hidden = Mapping[str, Any]


@dataclass(frozen=True)
class Attempt:
    """One attempted episode.

    Attributes:
        seed: seed of the episode.
        hidden_state: sampled values; None if no reachable layout was found.
        success: whether the expert succeeded.
        reason: ``success``, or the cause of failure.
        key_frames: number of key frames.
        late: whether it had a late start.
    """

    seed: int
    hidden_state: Hidden | None
    success: bool
    reason: str
    key_frames: int
    late: bool


@dataclass(frozen=True)
class ItemOutcome:
    """Result of an item.

    Attributes:
        attempts: all attempts, in order.
        kept: whether the last attempt is kept: a success, or any episode of a corrected policy.
        failed: attempt -> file content of a failed episode to keep; empty once written.
        episode: file content of the kept episode; None once written.
    """

    attempts: tuple[Attempt, ...]
    kept: bool = False
    failed: Mapping[int, bytes] = field(default_factory=dict)
    episode: bytes | None = None


def write_outcome(paths: CollectionPaths, item: EpisodeSpec, outcome: ItemOutcome) -> ItemOutcome:
    """Writes an outcome durably, with the file that marks it as done last; returns it without file contents."""
    for number, content in sorted(outcome.failed.items()):
        name = item.file_name.replace(".safetensors", f"-{number:03d}.safetensors")
        write_shard_bytes(paths.failed_episodes / name, content)
    if outcome.episode is not None:
        write_shard_bytes(paths.episodes / item.file_name, outcome.episode)
    else:
        attempts = json.dumps([vars(attempt) for attempt in outcome.attempts], sort_keys=True)
        files.write_atomically(attempts_file(paths, item), attempts.encode())
    return replace(outcome, failed={}, episode=None)


def attempts_file(paths: CollectionPaths, item: EpisodeSpec) -> Path:
    """Returns the file with the attempts at a given-up item."""
    return paths.attempts / item.file_name.replace(".safetensors", ".json")
