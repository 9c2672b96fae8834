"""Pictures for a dataset that was collected without: scenes set up anew, joints put where they stood, no physics."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip import files, schema
from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.checked_json import flag, integer, optional, parse, text
from lerobot_adamanip.demos.assemble import Contents, assemble
from lerobot_adamanip.demos.attempts import attempts_path, read_attempts
from lerobot_adamanip.demos.collection import CollectionPaths, manifest_path
from lerobot_adamanip.demos.loading import episode_table, load_check
from lerobot_adamanip.demos.manifest import HIDDEN_STATE, Manifest, differing_parts, read_manifest, write_manifest
from lerobot_adamanip.demos.record import EnvFactory
from lerobot_adamanip.demos.shards import RecordedEpisode, read_record, write_shard
from lerobot_adamanip.errors import DatasetError
from lerobot_adamanip.fingerprint import combined
from lerobot_adamanip.rollout import SimulatedEnvironment

Progress = Callable[[str, int, int], None]
TOLERANCE = 1e-5
"""How far the first joints of an episode may be from those of its scene set up anew [rad or m]."""
_JSON = ("hidden_state", "hidden_overrides", "start", "camera", "versions", "failures", "episode_record")


@dataclass(frozen=True)
class _Stored:
    """A dataset as it lies there: its rows, what each episode is, its tasks, and its manifest."""

    rows: Any
    episodes: list[dict[str, Any]]
    tasks: list[str]
    manifest: Manifest


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

    Each finished episode is safe on disk, in ``<out>.partial``: the same call goes on where another was interrupted.

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
    root, paths = root.absolute(), CollectionPaths(out.absolute())
    _require_free(root, paths)
    stored = _read(root, assets)
    manifest = _pictured(stored, make_env)
    _prepare(paths, manifest)
    shards = _rendered(paths, stored, manifest, make_env, progress)
    contents = Contents(manifest, shards, read_attempts(attempts_path(root)), repo_id or f"local/{paths.root.name}")
    built = assemble(paths.root, contents, lambda done, total: progress("assemble", done, total))
    files.move_durably(built, paths.root)
    paths.clean()
    return len(shards)


def _rendered(
    paths: CollectionPaths, stored: _Stored, manifest: Manifest, make_env: EnvFactory, progress: Progress
) -> list[Path]:
    """Renders the episodes that are not there yet; returns all their files, in order."""
    shards = []
    with _Environments(make_env, manifest) as environments:
        for number, row in enumerate(stored.episodes):
            path = paths.episodes / f"{number:06d}.safetensors"
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


def _require_free(root: Path, paths: CollectionPaths) -> None:
    if paths.root == root or (paths.root.exists() and (paths.root.is_file() or any(paths.root.iterdir()))):
        raise DatasetError(
            "There is something at the root of the new dataset.",
            got=paths.root,
            allowed="a folder that does not exist, or is empty",
            hint="another --out",
        )


def _prepare(paths: CollectionPaths, manifest: Manifest) -> None:
    """Makes the partial folder; what other code, or another dataset, left in it is thrown away."""
    known = paths.partial_manifest.read_bytes() if paths.partial_manifest.exists() else b""
    if known != (json.dumps(manifest.to_json(), indent=2, sort_keys=True) + "\n").encode():
        files.remove_tree(paths.partial)
    paths.episodes.mkdir(parents=True, exist_ok=True)
    write_manifest(paths.partial_manifest, manifest)


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
    rows = pq.read_table(sorted((root / "data").glob("*/*.parquet"))).sort_by("index")
    tasks = pq.read_table(root / "meta" / "tasks.parquet").to_pydict()
    names = next(values for key, values in tasks.items() if key != "task_index")
    ordered = [name for _, name in sorted(zip(tasks["task_index"], names, strict=True))]
    return _Stored(rows, episode_table(root).to_pylist(), ordered, read_manifest(manifest_path(root), assets))


def _pictured(stored: _Stored, make_env: EnvFactory) -> Manifest:
    """Returns the manifest of the dataset with images; raises `DatasetError` if what makes scenes has changed."""
    environment = stored.manifest.spec.environment.changed(observe_images=True)
    spec = replace(stored.manifest.spec, environment=environment)
    env = make_env(spec.environment_of(spec.categories[0]))
    try:
        found = env.fingerprint()
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
    images = np.stack([env.picture_at(joints) for joints in columns[schema.JOINTS]])
    return RecordedEpisode({**columns, schema.FRONT_IMAGE: images}, record)


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
    first, end = (
        integer(0, stored.rows.num_rows)(name, row[name]) for name in ("dataset_from_index", "dataset_to_index")
    )
    part = stored.rows.slice(first, end - first)
    environment = stored.manifest.spec.environment
    features = schema.dataset_features(environment.num_points, images=False)
    return stored.tasks[part["task_index"][0].as_py()], {
        key: np.asarray(part[key].to_pylist(), feature["dtype"]).reshape(-1, *feature["shape"])
        for key, feature in features.items()
    }


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
