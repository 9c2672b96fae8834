"""Identity of a collection's folders: checked before anything in them is kept, replaced or removed."""

from __future__ import annotations

from pathlib import Path

from lerobot_adamanip.datasets.collection_spec import CollectionPaths, manifest_path
from lerobot_adamanip.datasets.manifest import Manifest, read_manifest, require_same, write_manifest
from lerobot_adamanip.datasets.output_folder import count_episodes, is_free
from lerobot_adamanip.datasets.reading import load_check
from lerobot_adamanip.datasets.selection import selection_path
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError


def require_finished(root: Path, manifest: Manifest) -> None:
    """Raises `DatasetError` unless a dataset is the whole result of this collection.

    Parts of a dataset (`adamanip filter`, `adamanip split`) have its manifest, too; so has a repaired dataset.
    """
    stored = read_manifest(manifest_path(root), manifest.spec.environment.assets)
    require_same(stored, manifest, root)
    _require_no_part(root)
    found = load_check(root)["total_episodes"]
    kept = None if stored.attempts is None else stored.attempts.kept
    if found != kept:
        raise DatasetError(
            "The dataset does not have the episodes that were collected for it.",
            got=f"{found} episodes in {root}",
            allowed=f"{kept} episodes, as its {manifest_path(root).name} says",
            hint="another folder",
        )


def is_own_partial(paths: CollectionPaths, manifest: Manifest) -> bool:
    """Whether the partial folder is of this collection, or holds no episodes."""
    if not paths.partial_manifest.exists():
        return count_episodes(paths.partial) == 0
    try:
        _require_same_partial(paths, manifest)
    except DatasetError:
        return False
    return True


def prepare_partial(paths: CollectionPaths, manifest: Manifest) -> None:
    """Makes the partial folder, or checks that the one there is of this collection.

    Raises:
        DatasetError: it, or the dataset of failed episodes, holds episodes of another collection.
    """
    if manifest.spec.keep_failed and not is_free(paths.failed):
        _require_replaceable(paths.failed, manifest)
    if count_episodes(paths.partial):
        _require_same_partial(paths, manifest)
    elif not (paths.partial_manifest.exists() and is_own_partial(paths, manifest)):
        files.remove_tree(paths.attempts)  # another collection's accounts of items that it gave up
        write_manifest(paths.partial_manifest, manifest)
    for folder in (paths.episodes, paths.attempts, paths.failed_episodes):
        folder.mkdir(exist_ok=True)
        files.remove_temporaries(folder)
    files.sync_tree(paths.partial)
    files.sync(paths.root.parent)
    files.crash_point("collection prepared")


def _require_same_partial(paths: CollectionPaths, manifest: Manifest) -> None:
    stored = read_manifest(paths.partial_manifest, manifest.spec.environment.assets)
    require_same(stored, manifest, paths.partial)


def _require_replaceable(root: Path, manifest: Manifest) -> None:
    """Raises `DatasetError` unless a dataset of failed episodes is an earlier one of this collection."""
    if not manifest_path(root).exists():
        raise DatasetError(
            "There is something else where the failed episodes are to be.",
            got=root,
            allowed="a folder that does not exist, or is empty",
            hint="another folder, or without --keep-failed",
        )
    require_same(read_manifest(manifest_path(root), manifest.spec.environment.assets), manifest, root)
    _require_no_part(root)


def _require_no_part(root: Path) -> None:
    if selection_path(root).exists():
        raise DatasetError(
            "There is a part of a dataset, not a collection.",
            got=f"{root}, made by `adamanip filter`, `split` or `merge`",
            allowed="a folder that does not exist, is empty, or was made by `adamanip collect`",
            hint="another folder",
        )
