"""Assembly of episode files into a LeRobotDataset: written to a temporary folder, synced, and read back."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.datasets.appending import append, can_append, in_order
from lerobot_adamanip.datasets.attempts import AttemptRecord, attempts_jsonl, attempts_path
from lerobot_adamanip.datasets.cards import dataset_card
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.dataset import read_back
from lerobot_adamanip.datasets.encoding import EpisodeFile, Features, PreparedEpisode, preparing_session
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
        manifest: manifest of the collection.
        shards: episode files, in order.
        attempts: all attempts of the collection.
        repo_id: repository id in the dataset card.
    """

    manifest: Manifest
    shards: list[Path]
    attempts: list[AttemptRecord]
    repo_id: str


@dataclass(frozen=True)
class Recorded:
    """Contents of a dataset that is not a collection: episodes of any policy, without a manifest.

    Attributes:
        shards: episode files, in order.
        environment: options of the environment; ``observe_images`` is resolved.
        repo_id: repository id in the dataset card.
    """

    shards: list[Path]
    environment: EnvironmentOptions
    repo_id: str


def assemble(
    folder: Path, name: str, contents: Contents, progress: Callable[[int, int], None], workers: int = 1
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
    recorded = Recorded(contents.shards, contents.manifest.spec.environment, contents.repo_id)

    def describe() -> None:
        attempts_path(folder).write_bytes(attempts_jsonl(contents.attempts))
        write_manifest(manifest_path(folder), contents.manifest)

    return _assembled(folder, name, recorded, describe, progress=progress, workers=workers)


def assemble_recorded(folder: Path, name: str, recorded: Recorded) -> Path:
    """Writes a dataset without a manifest, syncs it and reads it back, like `assemble`."""
    box = recorded.environment.workspace
    workspace = None if box == DEFAULT_WORKSPACE else box
    return _assembled(folder, name, recorded, lambda: None, workspace=workspace)


def _assembled(
    folder: Path,
    name: str,
    recorded: Recorded,
    describe: Callable[[], None],
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
    workers: int = 1,
    workspace: Workspace | None = None,
) -> Path:
    if not recorded.shards:
        raise DatasetError(
            "No episode was recorded.", got="0 episodes", allowed="1 or more", hint="a larger --max-attempts"
        )
    files.crash_point("assembly begun")
    dataset = _empty(folder, recorded, workspace)
    records, lengths = append_shards(dataset, recorded.shards, progress, workers)
    files.crash_point("dataset written")
    _describe(folder, records, dataset.meta.features)
    describe()
    (folder / "README.md").write_text(dataset_card(folder, name, recorded.repo_id, recorded.environment.assets))
    files.crash_point("dataset described")
    files.sync_tree(folder)
    files.crash_point("dataset synced")
    read_back(folder, lengths)
    files.crash_point("dataset verified")
    return folder


def _empty(folder: Path, recorded: Recorded, workspace: Workspace | None) -> Any:
    environment = recorded.environment
    return create_dataset(
        folder,
        recorded.repo_id,
        num_points=environment.num_points,
        image_size=environment.image_size if environment.observe_images else None,
        intrinsics=read_shard(recorded.shards[0]).record["camera"].get("intrinsics"),
        workspace=workspace,
    )


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
    """Prepares and appends episodes; yields each record and row count."""
    items = [EpisodeFile(number, path) for number, path in enumerate(shards)]
    session = functools.partial(preparing_session, dataset.meta.features, dataset.meta.fps)
    workers = min(workers, len(items) // MIN_EPISODES_PER_WORKER)
    for episode in _prepared_by_workers(session, workers, items) if workers > 1 else _prepared(session, items):
        yield episode.record, append(dataset, episode)


def _prepared(session: Any, items: list[EpisodeFile]) -> Iterator[PreparedEpisode]:
    with session() as work:
        for item in items:
            yield work(item, lambda: None)


def _prepared_by_workers(session: Any, workers: int, items: list[EpisodeFile]) -> Iterator[PreparedEpisode]:
    def numbered(result: jobs.JobResult[EpisodeFile]) -> tuple[int, PreparedEpisode]:
        if result.death is not None:
            raise jobs.WorkerError(
                f"{result.item.path.name} could not be prepared: its worker crashed ({result.death})"
            )
        return result.item.number, result.value

    with jobs.WorkerPool[EpisodeFile](session, workers) as pool:
        yield from in_order(map(numbered, pool.run(items)))


def _written_by_lerobot(dataset: Any, shards: list[Path]) -> Iterator[tuple[dict[str, Any], int]]:
    """Writes episodes with LeRobot's writer: slower than `_appended`, whose result must be equal."""
    for path in shards:
        episode = read_shard(path)
        for row in range(len(episode)):
            frame = {key: column[row] for key, column in episode.columns.items()}
            dataset.add_frame({**frame, "task": episode.record["task"]})
        dataset.save_episode()
        yield episode.record, len(episode)


def _describe(root: Path, records: list[dict[str, Any]], features: Features) -> None:
    write_statistics(root, features)
    add_episode_columns(root, {key: [record[key] for record in records] for key in PLAIN_COLUMNS})
    add_episode_columns(root, {key: [to_json(record[key]) for record in records] for key in JSON_COLUMNS})
    (root / "meta" / "cameras.json").write_bytes(cameras_json([record["camera"] for record in records]))
    shutil.rmtree(root / "images", ignore_errors=True)
