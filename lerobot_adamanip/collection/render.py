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
from lerobot_adamanip.collection.record import EnvFactory, Environments, reset_scene
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import image_column, is_image_column
from lerobot_adamanip.contract.sensing import parse_sensing
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
from lerobot_adamanip.datasets.pose_statistics import keep_unscaled_poses
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.selection import identity, selection_path
from lerobot_adamanip.datasets.shards import RecordedEpisode, read_record, write_shard
from lerobot_adamanip.episode.options import EnvironmentOptions
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
        source, old = _open(resolve_output(root), assets)
        attempts = read_attempts(attempts_path(source.root))  # before the work, which a damaged list would waste
        manifest = _pictured(old, make_env)
        _require_same_work(output, manifest, source)
        if not is_free(output.root):
            _finish(output, manifest, len(source))
            return len(source)
        shards = _rendered(output, source, (old, manifest), make_env, progress)
        contents = Contents(
            shards,
            manifest.spec.environment,
            repo_id or f"local/{output.root.name}",
            manifest,
            attempts,
        )
        built = assemble(output.fresh("dataset"), output.root.name, contents, functools.partial(progress, "assemble"))
        keep_unscaled_poses(built, [source])
        if (selection := selection_path(source.root)).exists():
            files.write_atomically(selection_path(built), selection.read_bytes())
        output.publish(built)
    return len(source)


def _rendered(
    output: OutputFolder,
    source: Dataset,
    manifests: tuple[Manifest, Manifest],
    make_env: EnvFactory,
    progress: Progress,
) -> list[Path]:
    """Renders the missing episodes into the work folder; returns all episode files in order.

    ``manifests``: of the source and of the new dataset.
    """
    old, manifest = manifests
    output.require_free()
    output.require_room(2 * files.tree_bytes(source.root))
    folder, shards = output.work / "episodes", []
    write_manifest(output.work / MANIFEST, manifest)
    files.write_atomically(output.work / SOURCE, identity(source.root).encode())
    folder.mkdir(exist_ok=True)
    files.remove_temporaries(folder)
    with Environments(make_env, manifest.spec) as environments:
        for episode in source.episodes:
            path = folder / f"{episode.number:06d}.safetensors"
            if read_record(path) is None:
                env = environments.of(category_of(episode.row["object_id"]))
                write_shard(path, _with_images(env, source.recorded(episode.number, old), old.spec.environment))
            shards.append(path)
            progress("render", episode.number + 1, len(source))
    return shards


def _require_same_work(output: OutputFolder, manifest: Manifest, source: Dataset) -> None:
    """Raises `DatasetError` if the work folder belongs to another dataset or other code."""
    if count_episodes(output.work) == 0 and is_free(output.root):
        return
    require_same(read_manifest(output.work / MANIFEST, manifest.spec.environment.assets), manifest, output.work)
    stored = output.work / SOURCE
    if not stored.exists() or stored.read_text() != identity(source.root):
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


def _open(root: Path, assets: str | Path | None) -> tuple[Dataset, Manifest]:
    dataset = Dataset(root)
    pictures = [key for key in dataset.features if is_image_column(key)]
    if pictures or schema.JOINTS not in dataset.features:
        lacks = "has images already" if pictures else f"lacks {schema.JOINTS}"
        raise DatasetError(
            "No pictures can be added to this dataset.",
            got=f"{root} {lacks}",
            allowed="one made by `adamanip collect --no-images`",
            hint="use another dataset",
        )
    return dataset, dataset.manifest(assets)


def _pictured(before: Manifest, make_env: EnvFactory) -> Manifest:
    """Returns the manifest of the dataset with images; raises `DatasetError` if its scenes would differ now."""
    spec = replace(before.spec, environment=before.spec.environment.changed(observe_images=True))
    with contextlib.closing(make_env(spec.environment_of(spec.categories[0]))) as env:
        versions = env.software_versions()
    changed = [part for part in differing_parts(before.versions, versions) if part != "renderer"]
    if changed:
        raise DatasetError(
            f"The dataset was recorded with other versions: {', '.join(changed)} differ.",
            got="; ".join(f"{name} = {versions.get(name)}" for name in changed),
            allowed="; ".join(f"{name} = {before.versions.get(name)}" for name in changed),
            hint="install the versions of the recording: others may make other scenes from its seeds",
        )
    return replace(before, spec=spec, versions=versions)


def _with_images(env: SimulatedEnvironment, episode: RecordedEpisode, options: EnvironmentOptions) -> RecordedEpisode:
    """Returns an episode with images for all its rows, as late as the sensors of its ``options`` give them."""
    record, joints = episode.record, episode.columns[schema.JOINTS]
    reset_scene(env, record["object_id"], record["seed"], record["hidden_overrides"])
    # A late start begins in another state than its scene.
    at_start = record["late"] or bool(np.abs(env.joints() - joints[0]).max() <= TOLERANCE)
    if env.camera_parameters() != record["camera"] or not at_start:
        raise DatasetError(
            "The scene of an episode comes out differently than recorded.",
            got=f"seed {record['seed']} of {record['object_id']}",
            allowed="the recorded camera and joints",
            hint="use the code and versions of the recording",
        )
    late = parse_sensing(options.sensing).steps_late(options.fps) if options.is_dense else 0
    pictures = [env.pictures_at(joints[max(0, row - late)]) for row in range(len(joints))]
    images = {image_column(name): np.stack([picture[name] for picture in pictures]) for name in pictures[0]}
    versions = {**env.software_versions(), "cpu": cpu_model()}
    return RecordedEpisode({**episode.columns, **images}, {**record, "versions": versions})
