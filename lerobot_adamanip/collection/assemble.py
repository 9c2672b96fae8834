"""Assembly of episode files into a LeRobotDataset: written to a temporary folder, synced, and read back."""

from __future__ import annotations

import contextlib
import functools
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.datasets.appending import append, can_append, in_order, tasks_of_rows
from lerobot_adamanip.datasets.attempts import AttemptRecord, attempts_jsonl, attempts_path
from lerobot_adamanip.datasets.cards import dataset_card
from lerobot_adamanip.datasets.collection_spec import columns_of, manifest_path
from lerobot_adamanip.datasets.dataset import read_back
from lerobot_adamanip.datasets.encoding import EpisodeFile, PreparedEpisode, preparing_session
from lerobot_adamanip.datasets.episode import JSON_COLUMNS, PLAIN_COLUMNS, to_json
from lerobot_adamanip.datasets.manifest import Manifest, write_manifest
from lerobot_adamanip.datasets.shards import read_shard
from lerobot_adamanip.datasets.statistics import write_statistics
from lerobot_adamanip.datasets.writing import add_episode_columns, cameras_json, create_dataset
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util import files, jobs
from lerobot_adamanip.util.errors import DatasetError

MIN_EPISODES_PER_WORKER = 32
"""Episodes per additional worker process: importing LeRobot takes as long as preparing ten."""


@dataclass(frozen=True)
class Contents:
    """Contents of a dataset.

    Attributes:
        shards: episode files, in order.
        environment: options of the environment; ``observe_images`` is resolved.
        repo_id: repository id in the dataset card.
        manifest: manifest of the collection; None for episodes of any policy.
        attempts: all attempts of the collection.
    """

    shards: list[Path]
    environment: EnvironmentOptions
    repo_id: str
    manifest: Manifest | None = None
    attempts: Sequence[AttemptRecord] = ()


def assemble(
    folder: Path,
    name: str,
    contents: Contents,
    progress: Callable[[int, int], None] = lambda done, total: None,
    workers: int = 1,
) -> Path:
    """Writes a dataset, syncs it and reads it back. Its bytes do not depend on ``workers``.

    Args:
        folder: output folder; must not exist.
        name: final name of the folder.
        contents: contents of the dataset.
        progress: called with written and total episodes.
        workers: processes that prepare episodes, if there are enough episodes.

    Returns:
        ``folder``.

    Raises:
        DatasetError: there are no shards, a shard is damaged, or the written dataset cannot be read back.
    """
    if not contents.shards:
        raise DatasetError(
            "No episode was recorded.",
            got="0 episodes",
            allowed="1 or more",
            hint="a larger --max-attempts; DatasetRecorder: reset and step it before save",
        )
    files.crash_point("assembly begun")
    environment, box = contents.environment, contents.environment.workspace
    dataset = create_dataset(
        folder,
        contents.repo_id,
        features=columns_of(environment),
        fps=environment.fps if environment.is_dense else schema.FPS,
        intrinsics=read_shard(contents.shards[0]).record["camera"].get("intrinsics"),
        workspace=None if contents.manifest is not None or box == DEFAULT_WORKSPACE else box,
    )
    records, lengths = append_shards(dataset, contents.shards, progress, workers)
    files.crash_point("dataset written")
    write_statistics(folder, dataset.meta.features)
    add_episode_columns(folder, {key: [record[key] for record in records] for key in PLAIN_COLUMNS})
    add_episode_columns(folder, {key: [to_json(record[key]) for record in records] for key in JSON_COLUMNS})
    (folder / "meta" / "cameras.json").write_bytes(cameras_json([record["camera"] for record in records]))
    shutil.rmtree(folder / "images", ignore_errors=True)
    if contents.manifest is not None:
        attempts_path(folder).write_bytes(attempts_jsonl(contents.attempts))
        write_manifest(manifest_path(folder), contents.manifest)
    (folder / "README.md").write_text(dataset_card(folder, name, contents.repo_id, environment.assets))
    files.crash_point("dataset described")
    files.sync_tree(folder)
    files.crash_point("dataset synced")
    read_back(folder, lengths)
    files.crash_point("dataset verified")
    return folder


def append_shards(
    dataset: Any, shards: list[Path], progress: Callable[[int, int], None], workers: int = 1
) -> tuple[list[dict[str, Any]], list[int]]:
    """Writes all episodes and finalises the dataset; returns their records and row counts."""
    records: list[dict[str, Any]] = []
    lengths: list[int] = []
    appended = _appended(dataset, shards, workers) if can_append(dataset) else _written_by_lerobot(dataset, shards)
    for record, length in appended:
        records.append(record)
        lengths.append(length)
        files.crash_point("episode assembled")
        progress(len(records), len(shards))
    dataset.finalize()
    return records, lengths


def _appended(dataset: Any, shards: list[Path], workers: int) -> Iterator[tuple[dict[str, Any], int]]:
    """Prepares episodes, in processes if there are many, and appends them; yields each record and row count."""
    items = [EpisodeFile(number, path) for number, path in enumerate(shards)]
    session = functools.partial(preparing_session, dataset.meta.features, dataset.meta.fps)
    workers = min(workers, len(items) // MIN_EPISODES_PER_WORKER)
    with contextlib.ExitStack() as stack:
        if workers > 1:
            pool = stack.enter_context(jobs.WorkerPool[EpisodeFile](session, workers))
            episodes = in_order(map(_numbered, pool.run(items)))
        else:
            prepare = stack.enter_context(session())
            episodes = (prepare(item, lambda: None) for item in items)
        for episode in episodes:
            yield episode.record, append(dataset, episode)


def _numbered(result: jobs.JobResult[EpisodeFile]) -> tuple[int, PreparedEpisode]:
    if result.death is not None:
        raise jobs.WorkerError(f"{result.item.path.name} could not be prepared: its worker crashed ({result.death})")
    return result.item.number, result.value


def _written_by_lerobot(dataset: Any, shards: list[Path]) -> Iterator[tuple[dict[str, Any], int]]:
    """Writes episodes with LeRobot's writer: slower than `_appended`, whose result must be equal."""
    for path in shards:
        episode = read_shard(path)
        for row, task in enumerate(tasks_of_rows(episode.record, len(episode))):
            frame = {key: column[row] for key, column in episode.columns.items()}
            dataset.add_frame({**frame, "task": task})
        dataset.save_episode()
        yield episode.record, len(episode)
