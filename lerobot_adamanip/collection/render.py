"""Adds images to a dataset: rebuilds each scene from its seed and sets the recorded joint positions."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.assemble import Contents, assemble
from lerobot_adamanip.collection.collected_dataset import CollectedDataset
from lerobot_adamanip.collection.record import EnvFactory, Environments
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import image_column
from lerobot_adamanip.contract.versions import cpu_model
from lerobot_adamanip.datasets.attempts import attempts_path, read_attempts
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.dataset import Dataset, read_back
from lerobot_adamanip.datasets.manifest import Manifest, differing_parts, read_manifest, require_same, write_manifest
from lerobot_adamanip.datasets.output_folder import (
    RENDERING,
    OutputFolder,
    count_episodes,
    is_free,
    owned_output,
    resolve_output,
)
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.selection import identity, selection_path
from lerobot_adamanip.datasets.shards import RecordedEpisode, read_record, write_shard
from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError

Progress = Callable[[str, int, int], None]
MANIFEST, SOURCE = "collection.json", "source"
"""Files of the work folder: manifest of the new dataset, and identity of its source."""
TOLERANCE = 1e-5
"""Tolerance between an episode's first joint positions and its rebuilt scene [rad or m]."""


def add_pictures(
    root: Path,
    out: Path,
    make_env: EnvFactory,
    *,
    assets: str | Path | None = None,
    repo_id: str | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> int:
    """Writes a copy of a dataset with an image column; returns the number of episodes.

    Finished episodes are kept in ``<out>.rendering``, and the same call resumes there.

    Args:
        root: dataset collected without images.
        out: root of the new dataset; another folder.
        make_env: builds the environment; it never comes from the dataset.
        assets: folder of external assets, if the dataset uses any.
        repo_id: repository id in the dataset card; ``local/<folder name>`` by default.
        progress: called with the stage (``render``, ``assemble``), finished and total episodes.

    Raises:
        DatasetError: the dataset already has images or is incomplete, or its scenes have changed.
        SimulatorError: this machine cannot render.
    """
    require_repo_id(repo_id)
    with owned_output(out, RENDERING) as output:
        if not (output.work / MANIFEST).exists():
            output.require_free()
        source = _open(resolve_output(root), assets)
        _require_same_work(output, manifest := _pictured(source, make_env), source)
        if is_free(output.root):
            output.publish(_built(output, source, manifest, make_env, repo_id=repo_id, progress=progress))
        else:
            _finish(output, manifest, len(source.rows))
    return len(source.rows)


def _built(
    output: OutputFolder,
    source: CollectedDataset,
    manifest: Manifest,
    make_env: EnvFactory,
    *,
    repo_id: str | None,
    progress: Progress,
) -> Path:
    """Renders and assembles the new dataset in the work folder; returns its folder."""
    _prepare(output, manifest, source)
    shards = _rendered(output.work / "episodes", source, manifest, make_env, progress)
    attempts = read_attempts(attempts_path(source.source.root))
    contents = Contents(manifest, shards, attempts, repo_id or f"local/{output.root.name}")
    built = assemble(output.fresh("dataset"), output.root.name, contents, functools.partial(progress, "assemble"))
    if (selection := selection_path(source.source.root)).exists():
        files.write_atomically(selection_path(built), selection.read_bytes())
    return built


def _prepare(output: OutputFolder, manifest: Manifest, source: CollectedDataset) -> None:
    """Records the identity of the new dataset and of its source in the work folder."""
    output.require_free()
    output.require_room(2 * files.tree_bytes(source.source.root))
    write_manifest(output.work / MANIFEST, manifest)
    files.write_atomically(output.work / SOURCE, identity(source.source.root).encode())
    (output.work / "episodes").mkdir(exist_ok=True)
    files.remove_temporaries(output.work / "episodes")


def _rendered(
    folder: Path, source: CollectedDataset, manifest: Manifest, make_env: EnvFactory, progress: Progress
) -> list[Path]:
    """Renders the missing episodes; returns all episode files in order."""
    shards = []
    with Environments(make_env, manifest.spec) as environments:
        for number, row in enumerate(source.rows):
            path = folder / f"{number:06d}.safetensors"
            if read_record(path) is None:
                env = environments.of(category_of(row["object_id"]))
                write_shard(path, _with_images(env, source, number))
            shards.append(path)
            progress("render", number + 1, len(source.rows))
    return shards


def _require_same_work(output: OutputFolder, manifest: Manifest, dataset: CollectedDataset) -> None:
    """Raises `DatasetError` if the work folder belongs to another dataset or other code."""
    if count_episodes(output.work) == 0 and is_free(output.root):
        return
    require_same(read_manifest(output.work / MANIFEST, manifest.spec.environment.assets), manifest, output.work)
    source = output.work / SOURCE
    if not source.exists() or source.read_text() != identity(dataset.source.root):
        raise DatasetError(
            "Pictures of another dataset are in the work folder.",
            got=output.work,
            allowed="unfinished pictures of the same episodes",
            hint="use another --out, or finish the other dataset first",
        )


def _finish(output: OutputFolder, manifest: Manifest, episodes: int) -> None:
    """Cleans up after a run that was interrupted after moving the dataset into place."""
    root = output.root
    require_same(read_manifest(manifest_path(root), manifest.spec.environment.assets), manifest, root)
    read_back(root)
    if len(Dataset(root)) != episodes or selection_path(root).exists():
        raise DatasetError(
            "The output folder contains another dataset.",
            got=root,
            allowed=f"a folder that does not exist, or the {episodes} episodes with pictures",
            hint="use another --out",
        )
    output.discard()


def _open(root: Path, assets: str | Path | None) -> CollectedDataset:
    features = Dataset(root).features
    if schema.FRONT_IMAGE in features or schema.JOINTS not in features:
        lacks = "has images already" if schema.FRONT_IMAGE in features else f"lacks {schema.JOINTS}"
        raise DatasetError(
            "No pictures can be added to this dataset.",
            got=f"{root} {lacks}",
            allowed="one made by `adamanip collect --no-images`",
            hint="use another dataset",
        )
    return CollectedDataset.open(root, assets)


def _pictured(source: CollectedDataset, make_env: EnvFactory) -> Manifest:
    """Returns the manifest of the dataset with images; raises `DatasetError` if its scenes would differ now."""
    before = source.manifest
    spec = replace(before.spec, environment=before.spec.environment.changed(observe_images=True))
    with contextlib.closing(make_env(spec.environment_of(spec.categories[0]))) as env:
        found = env.software_versions()
    changed = [part for part in differing_parts(before.versions, found) if part != "renderer"]
    if changed:
        raise DatasetError(
            f"The dataset was recorded with other versions: {', '.join(changed)} differ.",
            got="; ".join(f"{name} = {found.get(name)}" for name in changed),
            allowed="; ".join(f"{name} = {before.versions.get(name)}" for name in changed),
            hint="install the versions of the recording: others may make other scenes from its seeds",
        )
    return replace(before, spec=spec, versions=found)


def _with_images(env: SimulatedEnvironment, source: CollectedDataset, number: int) -> RecordedEpisode:
    """Returns an episode with images for all its rows."""
    episode = source.episode(number)
    record, joints = episode.record, episode.columns[schema.JOINTS]
    episode.reset(env)
    # A late start begins in another state than its scene.
    at_start = record["late"] or bool(np.abs(env.joints() - joints[0]).max() <= TOLERANCE)
    if env.camera_parameters() != record["camera"] or not at_start:
        raise DatasetError(
            "The scene of an episode comes out differently than recorded.",
            got=f"seed {record['seed']} of {record['object_id']}",
            allowed="the recorded camera and joints",
            hint="use the code and versions of the recording",
        )
    pictures = [env.pictures_at(each) for each in joints]
    images = {image_column(name): np.stack([each[name] for each in pictures]) for name in pictures[0]}
    versions = {**env.software_versions(), "cpu": cpu_model()}
    return RecordedEpisode({**episode.columns, **images}, {**record, "versions": versions})
