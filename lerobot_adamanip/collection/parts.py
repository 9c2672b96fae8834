"""Parts of a collection, recorded apart by machines that know nothing of each other, and put together afterwards."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.collection.outcome import ItemReport, read_given_up
from lerobot_adamanip.collection.summary import ItemResult
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, EpisodeSpec
from lerobot_adamanip.datasets.manifest import Manifest, read_manifest, require_same
from lerobot_adamanip.datasets.output_folder import lock_output, resolve_output
from lerobot_adamanip.datasets.shards import read_record, write_shard_bytes
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.fingerprint import combined

MAX_PARTS = 100_000


@dataclass(frozen=True)
class Part:
    """Every ``count``-th episode of a collection, from the ``number``-th on (counted from 1)."""

    number: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count <= MAX_PARTS:
            raise _no_part(f"{self.number}/{self.count}")

    @classmethod
    def parse(cls, text: str) -> Part:
        """Returns the part that ``K/N`` names; raises `ConfigurationError`."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if found is None:
            raise _no_part(text)
        return cls(int(found[1]), int(found[2]))

    def of(self, items: list[EpisodeSpec]) -> list[EpisodeSpec]:
        """Returns the episodes of this part."""
        return items[self.number - 1 :: self.count]


def _no_part(got: str) -> ConfigurationError:
    return ConfigurationError("No such part.", got=got, allowed="K/N, K from 1 to N", hint="--part 1/8")


def adopt(paths: CollectionPaths, manifest: Manifest, sources: Iterable[Path]) -> None:
    """Copies into a collection what parts of it have recorded; what is there already stays as it is.

    Args:
        paths: of the collection, prepared.
        manifest: of the collection.
        sources: roots of the parts.

    Raises:
        DatasetError: one of them is no part, or one of another collection, or still at work, or damaged.
    """
    for source in sources:
        part = CollectionPaths(resolve_output(source))
        if part.root == paths.root or not part.partial_manifest.is_file():
            raise DatasetError(
                "Nothing was recorded there.",
                got=part.partial,
                allowed="the folder of `adamanip collect --part K/N`",
                hint="the same options and --part K/N, on the machine that lacks it",
            )
        with lock_output(part.root, optional=True):  # a part may be read-only
            stored = read_manifest(part.partial_manifest, manifest.spec.environment.assets)
            require_same(stored, manifest, part.partial)
            for item in manifest.spec.items():
                _adopt_item(paths, part, manifest, item)


def belongs(path: Path, manifest: Manifest, item: EpisodeSpec) -> bool:
    """Whether a file holds an episode, or a failed attempt, of this item of this collection."""
    record = read_record(path)
    whose = None if record is None else (record.get("slot"), record.get("object_id"), record.get("fingerprint"))
    return whose == (item.slot, item.object_id, combined(manifest.fingerprint))


def failed_attempts(folder: Path, item: EpisodeSpec) -> list[Path]:
    """Returns the files of an item's failed attempts, in their order."""
    stem = item.file_name.removesuffix(".safetensors")
    return [
        path
        for path in sorted(folder.glob(f"{stem}-*.safetensors"))
        if re.fullmatch(r"\d{3,6}", path.stem.removeprefix(f"{stem}-"))
    ]


def _adopt_item(paths: CollectionPaths, part: CollectionPaths, manifest: Manifest, item: EpisodeSpec) -> None:
    stem = item.file_name.removesuffix(".safetensors")
    if not (paths.episodes / item.file_name).exists() and (part.episodes / item.file_name).exists():
        _copy_shard(part.episodes / item.file_name, paths.episodes, manifest, item)
    for path in failed_attempts(part.failed_episodes, item):
        if not (paths.failed_episodes / path.name).exists():
            _copy_shard(path, paths.failed_episodes, manifest, item)
    account = part.attempts / f"{stem}.json"
    if account.exists() and not (paths.attempts / account.name).exists():
        files.write_atomically(paths.attempts / account.name, account.read_bytes())


def _copy_shard(path: Path, folder: Path, manifest: Manifest, item: EpisodeSpec) -> None:
    if not belongs(path, manifest, item):
        raise DatasetError(
            "An episode of a part is damaged, or is not what its name says.",
            got=path,
            allowed=f"{item}, recorded under fingerprint {combined(manifest.fingerprint)}",
            hint="delete this file and run the part again",
        )
    write_shard_bytes(folder / path.name, path.read_bytes())


def given_up(paths: CollectionPaths, items: Iterable[EpisodeSpec], max_attempts: int) -> list[ItemResult]:
    """Returns those of the items that a part has given up after ``max_attempts``."""
    accounts = {item: tuple(read_given_up(paths, item)) for item in items}
    return [ItemResult(item, ItemReport(each), 0.0) for item, each in accounts.items() if len(each) >= max_attempts]
