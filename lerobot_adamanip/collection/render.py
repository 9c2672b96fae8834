"""Pictures for a dataset that was collected without: scenes set up anew, joints put where they stood, no physics."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.assemble import Contents, assemble
from lerobot_adamanip.collection.fingerprint import collection_fingerprint
from lerobot_adamanip.collection.record import EnvFactory
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import image_column
from lerobot_adamanip.datasets.attempts import attempts_path, read_attempts
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.manifest import (
    HIDDEN_STATE,
    Manifest,
    differing_parts,
    read_manifest,
    require_same,
    write_manifest,
)
from lerobot_adamanip.datasets.output_folder import (
    RENDERING,
    OutputFolder,
    count_episodes,
    is_free,
    owned_output,
    resolve_output,
)
from lerobot_adamanip.datasets.reading import episode_table, load_check, read_back
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.selection import identity, selection_path
from lerobot_adamanip.datasets.shards import RecordedEpisode, read_record, write_shard
from lerobot_adamanip.datasets.source import Source
from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.fingerprint import combined
from lerobot_adamanip.util.json_fields import flag, integer, optional, parse, text

Progress = Callable[[str, int, int], None]
MANIFEST, SOURCE = "collection.json", "source"
"""Files of the work folder: the manifest of the new dataset, and which one it is made from."""
TOLERANCE = 1e-5
"""How far the first joints of an episode may be from those of its scene set up anew [rad or m]."""
_JSON = ("hidden_state", "hidden_overrides", "start", "camera", "versions", "failures", "episode_record")


@dataclass(frozen=True)
class _Stored:
    """A dataset on disk: its episodes, rows and manifest."""

    source: Source
    episodes: list[dict[str, Any]]
    manifest: Manifest

    @property
    def identity(self) -> str:
        """Hash of what tells the episodes apart from those of any other dataset."""
        return identity(self.source.root)


def add_pictures(
    root: Path,
    out: Path,
    make_env: EnvFactory,
    *,
    assets: str | Path | None = None,
    repo_id: str | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> int:
    """Writes a copy of a dataset with the column of images; returns its number of episodes.

    Finished episodes are kept in ``<out>.rendering``, where the same call resumes.

    Args:
        root: of a dataset collected without images.
        out: of the new one; another folder.
        make_env: builds the environment; nothing in the dataset does.
        assets: folder of external assets, if the dataset used any.
        repo_id: written into its card; ``local/<folder name>`` by default.
        progress: told of stage (``render``, ``assemble``), episodes done, and all.

    Raises:
        DatasetError: it has images, or is not whole, or its scenes come out differently now.
        SimulatorError: there is nothing to render with.
    """
    require_repo_id(repo_id)
    with owned_output(out, RENDERING) as output:
        if not (output.work / MANIFEST).exists():
            output.require_free()
        stored = _read(resolve_output(root), assets)
        _require_same_work(output, manifest := _pictured(stored, make_env), stored)
        if is_free(output.root):
            shards = _rendered(_prepared(output, manifest, stored), stored, manifest, make_env, progress)
            tried = read_attempts(attempts_path(stored.source.root))
            contents = Contents(manifest, shards, tried, repo_id or f"local/{output.root.name}")
            output.publish(_assembled(output, stored, contents, functools.partial(progress, "assemble")))
        else:
            _finish(output, manifest, len(stored.episodes))
    return len(stored.episodes)


def _prepared(output: OutputFolder, manifest: Manifest, stored: _Stored) -> Path:
    """Notes in the work folder what is made there; returns its folder of episodes."""
    output.require_free()
    output.require_room(2 * files.tree_bytes(stored.source.root))
    write_manifest(output.work / MANIFEST, manifest)
    files.write_atomically(output.work / SOURCE, stored.identity.encode())
    folder = output.work / "episodes"
    folder.mkdir(exist_ok=True)
    files.remove_temporaries(folder)
    return folder


def _assembled(output: OutputFolder, stored: _Stored, contents: Contents, progress: Callable[[int, int], None]) -> Path:
    built = assemble(output.fresh("dataset"), output.root.name, contents, progress)
    if (selection := selection_path(stored.source.root)).exists():
        files.write_atomically(selection_path(built), selection.read_bytes())
    return built


def _rendered(
    folder: Path, stored: _Stored, manifest: Manifest, make_env: EnvFactory, progress: Progress
) -> list[Path]:
    """Renders the episodes that are not there yet; returns all their files, in order."""
    shards = []
    with _Environments(make_env, manifest) as environments:
        for number, row in enumerate(stored.episodes):
            path = folder / f"{number:06d}.safetensors"
            if read_record(path) is None:
                env = environments.of(category_of(row["object_id"]))
                write_shard(path, _with_images(env, stored, row, combined(manifest.fingerprint)))
            shards.append(path)
            progress("render", number + 1, len(stored.episodes))
    return shards


class _Environments:
    """One simulator at a time, that of the category asked for last."""

    def __init__(self, make_env: EnvFactory, manifest: Manifest) -> None:
        self._make, self._spec = make_env, manifest.spec
        self._category = ""
        self._env: SimulatedEnvironment | None = None

    def of(self, category: str) -> SimulatedEnvironment:
        if self._env is None or category != self._category:
            self.__exit__()
            self._category, self._env = category, self._make(self._spec.environment_of(category))
        return self._env

    def __enter__(self) -> _Environments:
        return self

    def __exit__(self, *_: object) -> None:
        if self._env is not None:
            self._env.close()
        self._env = None


def _require_same_work(output: OutputFolder, manifest: Manifest, stored: _Stored) -> None:
    """Raises `DatasetError` if the work folder holds pictures of another dataset, or by other code."""
    if count_episodes(output.work) == 0 and is_free(output.root):
        return
    require_same(read_manifest(output.work / MANIFEST, manifest.spec.environment.assets), manifest, output.work)
    source = output.work / SOURCE
    if not source.exists() or source.read_text() != stored.identity:
        raise DatasetError(
            "Pictures of another dataset wait there.",
            got=output.work,
            allowed="pictures of the same episodes",
            hint="another --out; or finish the other dataset first",
        )


def _finish(output: OutputFolder, manifest: Manifest, episodes: int) -> None:
    """Cleans up after a run that was interrupted when it had moved the dataset into place."""
    root = output.root
    require_same(read_manifest(manifest_path(root), manifest.spec.environment.assets), manifest, root)
    read_back(root)
    if load_check(root)["total_episodes"] != episodes or selection_path(root).exists():
        raise DatasetError(
            "There is another dataset at the root of the new one.",
            got=root,
            allowed=f"a folder that does not exist, or the {episodes} episodes with pictures",
            hint="another --out",
        )
    output.discard()


def _read(root: Path, assets: str | Path | None) -> _Stored:
    info = load_check(root)
    if schema.FRONT_IMAGE in info["features"] or schema.JOINTS not in info["features"]:
        lacks = "has images already" if schema.FRONT_IMAGE in info["features"] else f"lacks {schema.JOINTS}"
        raise DatasetError(
            "No pictures can be added to this dataset.",
            got=f"{root} {lacks}",
            allowed="one made by `adamanip collect --no-images`",
            hint="another dataset",
        )
    manifest = read_manifest(manifest_path(root), assets)
    return _Stored(Source(root, info), episode_table(root).to_pylist(), manifest)


def _pictured(stored: _Stored, make_env: EnvFactory) -> Manifest:
    """Returns the manifest of the dataset with images; raises `DatasetError` if what makes scenes has changed."""
    spec = replace(stored.manifest.spec, environment=stored.manifest.spec.environment.changed(observe_images=True))
    env = make_env(spec.environment_of(spec.categories[0]))
    try:
        found = collection_fingerprint(env)
    finally:
        env.close()
    changed = [part for part in differing_parts(stored.manifest.fingerprint, found) if part != "renderer"]
    if changed:
        raise DatasetError(
            f"The dataset was recorded under another fingerprint: {', '.join(changed)} differ.",
            got="; ".join(f"{name} = {found.get(name)}" for name in changed),
            allowed="; ".join(f"{name} = {stored.manifest.fingerprint.get(name)}" for name in changed),
            hint="the code and versions of before: other code may make other scenes of its seeds",
        )
    return replace(stored.manifest, spec=spec, fingerprint=found)


def _with_images(env: SimulatedEnvironment, stored: _Stored, row: dict[str, Any], fingerprint: str) -> RecordedEpisode:
    """Returns an episode with the pictures of its rows."""
    try:
        task, columns = _columns(stored, row)
        record = {**_record(row, stored, fingerprint), "task": task}
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise DatasetError(
            "What the dataset tells of an episode cannot be.",
            got=f"episode {row.get('episode_index')}: {error}",
            allowed="rows as `adamanip collect` writes them",
            hint="collect the dataset again",
        ) from error
    overrides = {} if record["hidden_overrides"] is None else {"hidden_overrides": record["hidden_overrides"]}
    env.reset(seed=record["seed"], options={"object_id": record["object_id"], **overrides})
    _require_same_scene(env, record, columns[schema.JOINTS][0])
    pictures = [env.pictures_at(joints) for joints in columns[schema.JOINTS]]
    images = {image_column(name): np.stack([each[name] for each in pictures]) for name in pictures[0]}
    return RecordedEpisode({**columns, **images}, record)


def _record(row: dict[str, Any], stored: _Stored, fingerprint: str) -> dict[str, Any]:
    parsed = {name: parse(text(r"(?s).*", "text")(name, row[name])) for name in _JSON}
    record = {**row, **parsed, "fingerprint": fingerprint}
    if record["object_id"] not in stored.manifest.spec.objects:
        raise ValueError("object_id is none of the collection's")
    integer(0, 2**63 - 1)("seed", record["seed"])
    flag("success", record["success"])
    optional(HIDDEN_STATE)("hidden_overrides", record["hidden_overrides"])
    return record


def _columns(stored: _Stored, row: dict[str, Any]) -> tuple[str, dict[str, NDArray[Any]]]:
    """Returns an episode's task and columns."""
    part = stored.source.rows(row)
    features = schema.dataset_features(stored.manifest.spec.environment.num_points, cameras=())
    columns = {
        key: _array(part[key]).astype(feature["dtype"], copy=False).reshape(len(part), *feature["shape"])
        for key, feature in features.items()
    }
    return stored.source.tasks[part["task_index"][0].as_py()], columns


def _array(column: pa.ChunkedArray) -> NDArray[Any]:
    """Returns the values of a column of numbers, or of lists of such, in one dimension."""
    values = column.combine_chunks()
    while pa.types.is_nested(values.type):
        values = values.flatten()
    array: NDArray[Any] = values.to_numpy(zero_copy_only=False)
    return array


def _require_same_scene(env: SimulatedEnvironment, record: Mapping[str, Any], first: NDArray[np.float32]) -> None:
    camera = env.camera_parameters() == record["camera"]
    # An episode that starts late starts elsewhere than its scene does.
    joints = record["late"] or bool(np.abs(env.joints() - first).max() <= TOLERANCE)
    if not (camera and joints):
        raise DatasetError(
            "The scene of an episode comes out differently now.",
            got=f"seed {record['seed']} of {record['object_id']}",
            allowed="the camera and the joints that were recorded",
            hint="the code and versions of before",
        )
