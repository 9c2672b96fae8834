"""Folder of an unfinished collection: checks before its content is kept, replaced or removed; import of parts.

Parts of a collection are recorded independently on several machines, then combined.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from lerobot_adamanip.collection.record import Attempt, ItemOutcome, attempts_file
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, EpisodeSpec, manifest_path
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.manifest import (
    Manifest,
    are_same_versions,
    read_manifest,
    require_same,
    write_manifest,
)
from lerobot_adamanip.datasets.output_folder import count_episodes, is_free, lock_output, resolve_output
from lerobot_adamanip.datasets.shards import read_record, write_shard_bytes
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.jobs import JobResult
from lerobot_adamanip.util.json_fields import read


@dataclass(frozen=True)
class Part:
    """Every ``count``-th episode of a collection, starting with the ``number``-th (from 1)."""

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Part:
        """Returns the part in the text ``K/N``; raises `ConfigurationError` if it is invalid."""
        match = re.fullmatch(r"(\d{1,5})/(\d{1,5})", text)
        part = cls(int(match[1]), int(match[2])) if match else cls(0, 0)
        if not 1 <= part.number <= part.count:
            raise ConfigurationError("No such part.", got=text, allowed="K/N, K from 1 to N", hint="--part 1/8")
        return part

    def of(self, items: list[EpisodeSpec]) -> list[EpisodeSpec]:
        """Returns the episodes of this part."""
        return items[self.number - 1 :: self.count]


# Identity -------------------------------------------------------------------------------------------------------------


def require_finished(root: Path, manifest: Manifest) -> None:
    """Raises `DatasetError` unless the dataset is the complete result of this collection."""
    stored = _require_same(manifest_path(root), manifest, root)
    episodes = len(Dataset(root))
    kept = None if stored.attempts is None else stored.attempts.kept
    if episodes != kept:
        raise DatasetError(
            "The dataset does not have the episodes of its manifest.",
            got=f"{episodes} episodes in {root}",
            allowed=f"{kept} episodes, as its {manifest_path(root).name} says",
            hint="use another folder",
        )


def require_same_options(root: Path, spec: CollectionSpec) -> None:
    """Raises `DatasetError` if a folder holds a collection with other options. Needs no simulator."""
    paths = CollectionPaths(root.absolute())
    for path, folder in ((paths.manifest, paths.root), (paths.partial_manifest, paths.partial)):
        if path.is_file() and (folder == paths.root or count_episodes(folder)):
            stored = read_manifest(path, spec.environment.assets)
            require_same(stored, replace(stored, spec=spec), folder)


def is_own_partial(paths: CollectionPaths, manifest: Manifest) -> bool:
    """Returns whether the partial folder belongs to this collection or has no episodes."""
    if not paths.partial_manifest.exists():
        return count_episodes(paths.partial) == 0
    with contextlib.suppress(DatasetError):
        return bool(_require_same(paths.partial_manifest, manifest, paths.partial))
    return False


def belongs(path: Path, manifest: Manifest, item: EpisodeSpec) -> bool:
    """Returns whether a file contains a kept or failed episode of this item and collection."""
    record = read_record(path) or {}
    place = (record.get("slot"), record.get("object_id"))
    return place == (item.slot, item.object_id) and are_same_versions(record.get("versions"), manifest.versions)


def _require_same(path: Path, manifest: Manifest, where: Path) -> Manifest:
    stored = read_manifest(path, manifest.spec.environment.assets)
    require_same(stored, manifest, where)
    return stored


# Content --------------------------------------------------------------------------------------------------------------


def prepare_partial(paths: CollectionPaths, manifest: Manifest, parts: Iterable[Path] = ()) -> None:
    """Creates the partial folder, or checks that the existing one belongs to this collection; imports parts.

    Args:
        paths: folders of the collection.
        manifest: manifest of the collection.
        parts: root folders of parts, whose episodes are copied; existing files stay as they are.

    Raises:
        DatasetError: it, or the dataset of failed episodes, contains episodes of another collection; or a part is not
            of this collection, is still being recorded, or is damaged.
    """
    if manifest.spec.keep_failed and not is_free(paths.failed):
        _require_same(manifest_path(paths.failed), manifest, paths.failed)
    if count_episodes(paths.partial):
        _require_same(paths.partial_manifest, manifest, paths.partial)
    elif not (paths.partial_manifest.exists() and is_own_partial(paths, manifest)):
        files.remove_tree(paths.attempts)  # given-up items of another collection
        write_manifest(paths.partial_manifest, manifest)
    for folder in (paths.episodes, paths.attempts, paths.failed_episodes):
        folder.mkdir(exist_ok=True)
        files.remove_temporaries(folder)
    files.sync_tree(paths.partial)
    files.sync(paths.root.parent)
    files.crash_point("collection prepared")
    for root in parts:
        part = CollectionPaths(resolve_output(root))
        if part.root == paths.root or not part.partial_manifest.is_file():
            raise DatasetError(
                "Nothing was recorded there.",
                got=part.partial,
                allowed="the folder of `adamanip collect --part K/N`",
                hint="run the same options with --part K/N on the machine without it",
            )
        with lock_output(part.root, optional=True):  # a part may be read-only
            _require_same(part.partial_manifest, manifest, part.partial)
            for item in manifest.spec.items():
                _import_item(paths, part, manifest, item)


def _import_item(paths: CollectionPaths, part: CollectionPaths, manifest: Manifest, item: EpisodeSpec) -> None:
    copies = {path: paths.failed_episodes / path.name for path in failed_attempts(part.failed_episodes, item)}
    copies[part.episodes / item.file_name] = paths.episodes / item.file_name
    for source, target in copies.items():
        if not source.exists() or target.exists():
            continue
        if not belongs(source, manifest, item):
            raise DatasetError(
                "An episode of a part is damaged, or is not what its name says.",
                got=source,
                allowed=f"{item}, recorded with the versions of the collection",
                hint="delete this file and run the part again",
            )
        write_shard_bytes(target, source.read_bytes())
    attempts = attempts_file(part, item)
    if attempts.exists() and not attempts_file(paths, item).exists():
        files.write_atomically(attempts_file(paths, item), attempts.read_bytes())


def failed_attempts(folder: Path, item: EpisodeSpec) -> list[Path]:
    """Returns the files of an item's failed attempts, in order."""
    stem = item.file_name.removesuffix(".safetensors")
    paths = sorted(folder.glob(f"{stem}-*.safetensors"))
    return [path for path in paths if re.fullmatch(r"\d{3,6}", path.stem.removeprefix(f"{stem}-"))]


def given_up(paths: CollectionPaths, items: Iterable[EpisodeSpec], max_attempts: int) -> list[JobResult[EpisodeSpec]]:
    """Returns the results of items that a part gave up after ``max_attempts``."""
    results = []
    for item in items:
        with contextlib.suppress(OSError, ValueError, TypeError):
            attempts = tuple(Attempt(**attempt) for attempt in read(attempts_file(paths, item)))
            if len(attempts) >= max_attempts:
                results.append(JobResult(item, ItemOutcome(attempts)))
    return results
