"""Identity checks of a collection's folders, before their content is kept, replaced or removed."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, manifest_path
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.manifest import Manifest, read_manifest, require_same, write_manifest
from lerobot_adamanip.datasets.output_folder import count_episodes, is_free
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError


def require_finished(root: Path, manifest: Manifest) -> None:
    """Raises `DatasetError` unless the dataset is the complete result of this collection."""
    stored = _require_same(manifest_path(root), manifest, root)
    found = len(Dataset(root))
    kept = None if stored.attempts is None else stored.attempts.kept
    if found != kept:
        raise DatasetError(
            "The dataset does not have the episodes of its manifest.",
            got=f"{found} episodes in {root}",
            allowed=f"{kept} episodes, as its {manifest_path(root).name} says",
            hint="use another folder",
        )


def _require_same(path: Path, manifest: Manifest, where: Path) -> Manifest:
    stored = read_manifest(path, manifest.spec.environment.assets)
    require_same(stored, manifest, where)
    return stored


def require_same_options(root: Path, spec: CollectionSpec) -> None:
    """Raises `DatasetError` if a folder holds a collection with other options. Needs no simulator."""
    paths = CollectionPaths(root.absolute())
    for path, where in ((paths.manifest, paths.root), (paths.partial_manifest, paths.partial)):
        if path.is_file() and (where == paths.root or count_episodes(where)):
            stored = read_manifest(path, spec.environment.assets)
            require_same(stored, replace(stored, spec=spec), where)


def is_own_partial(paths: CollectionPaths, manifest: Manifest) -> bool:
    """Returns whether the partial folder belongs to this collection or has no episodes."""
    if not paths.partial_manifest.exists():
        return count_episodes(paths.partial) == 0
    with contextlib.suppress(DatasetError):
        return bool(_require_same(paths.partial_manifest, manifest, paths.partial))
    return False


def prepare_partial(paths: CollectionPaths, manifest: Manifest) -> None:
    """Creates the partial folder, or checks that the existing one belongs to this collection.

    Raises:
        DatasetError: it, or the dataset of failed episodes, contains episodes of another collection.
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
