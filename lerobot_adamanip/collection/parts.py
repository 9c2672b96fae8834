"""Parts of a collection: recorded independently on several machines, then combined."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.collection.outcome import Attempt, ItemOutcome, attempts_file
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, EpisodeSpec
from lerobot_adamanip.datasets.manifest import Manifest, are_same_versions, read_manifest, require_same
from lerobot_adamanip.datasets.output_folder import lock_output, resolve_output
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
        found = re.fullmatch(r"(\d{1,5})/(\d{1,5})", text)
        part = cls(int(found[1]), int(found[2])) if found else cls(0, 0)
        if not 1 <= part.number <= part.count:
            raise ConfigurationError("No such part.", got=text, allowed="K/N, K from 1 to N", hint="--part 1/8")
        return part

    def of(self, items: list[EpisodeSpec]) -> list[EpisodeSpec]:
        """Returns the episodes of this part."""
        return items[self.number - 1 :: self.count]


def import_parts(paths: CollectionPaths, manifest: Manifest, sources: Iterable[Path]) -> None:
    """Copies the recorded episodes of parts into a collection; existing files stay as they are.

    Args:
        paths: folders of the collection, already prepared.
        manifest: manifest of the collection.
        sources: root folders of the parts.

    Raises:
        DatasetError: a source is not a part of this collection, is still being recorded, or is damaged.
    """
    for source in sources:
        part = CollectionPaths(resolve_output(source))
        if part.root == paths.root or not part.partial_manifest.is_file():
            raise DatasetError(
                "Nothing was recorded there.",
                got=part.partial,
                allowed="the folder of `adamanip collect --part K/N`",
                hint="run the same options with --part K/N on the machine without it",
            )
        with lock_output(part.root, optional=True):  # a part may be read-only
            stored = read_manifest(part.partial_manifest, manifest.spec.environment.assets)
            require_same(stored, manifest, part.partial)
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
    given_up = attempts_file(part, item)
    if given_up.exists() and not attempts_file(paths, item).exists():
        files.write_atomically(attempts_file(paths, item), given_up.read_bytes())


def belongs(path: Path, manifest: Manifest, item: EpisodeSpec) -> bool:
    """Returns whether a file contains a kept or failed episode of this item and collection."""
    record = read_record(path) or {}
    place = (record.get("slot"), record.get("object_id"))
    return place == (item.slot, item.object_id) and are_same_versions(record.get("versions"), manifest.versions)


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
            attempts = [Attempt(**each) for each in read(attempts_file(paths, item))]
            if len(attempts) >= max_attempts:
                results.append(JobResult(item, ItemOutcome(tuple(attempts))))
    return results
