"""Replaying a recorded episode in the simulator: does what was recorded happen again?"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.fingerprint import collection_fingerprint
from lerobot_adamanip.collection.record import EnvFactory
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.observation import observation_columns
from lerobot_adamanip.datasets.check.findings import Progress as CheckProgress
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.manifest import HIDDEN_STATE, Manifest, asset_hash, differing_parts, read_manifest
from lerobot_adamanip.datasets.reading import as_typed, episode_table, load_check, open_dataset
from lerobot_adamanip.datasets.start_column import read_start
from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.json_fields import flag, integer, optional, parse, text
from lerobot_adamanip.util.video import write_video

Picture = NDArray[np.uint8]
_COMPARED = (schema.STATE, schema.POINT_CLOUD, schema.EFFORT)
_LONGEST = 10_000
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class ReplayResult:
    """How a replay compares with its recording.

    Attributes:
        episode: index in the dataset.
        object_id: of the object.
        seed: of the episode.
        key_frames: recorded.
        replayed: key frames before the replayed episode ended.
        differences: column -> largest absolute difference over all key frames, in the column's units.
        success: whether the replay did the task.
        recorded_success: whether the recording did.
        changed: parts of the fingerprint that differ between the recording and this program.
    """

    episode: int
    object_id: str
    seed: int
    key_frames: int
    replayed: int
    differences: dict[str, float]
    success: bool
    recorded_success: bool
    changed: tuple[str, ...] = ()

    def agrees(self, tolerance: float) -> bool:
        """Returns whether the same thing happened, up to ``tolerance`` in every column."""
        same_end = self.success == self.recorded_success and self.replayed == self.key_frames
        return same_end and all(value <= tolerance for value in self.differences.values())


@dataclass(frozen=True)
class _Recording:
    """An episode as recorded: columns of all rows, facts about it, and the actions that led to its start."""

    columns: dict[str, NDArray[Any]]
    object_id: str
    seed: int
    success: bool
    overrides: dict[str, Any] | None
    prefix: NDArray[np.float32] = field(repr=False)


def replay(
    root: str | Path,
    episode: int,
    make_env: EnvFactory,
    *,
    assets: str | Path | None = None,
    video: str | Path | None = None,
    progress: Progress = lambda done, total: None,
) -> ReplayResult:
    """Runs an episode's recorded actions from its recorded start and compares what is seen.

    Args:
        root: of a dataset that ``adamanip collect`` wrote.
        episode: index.
        make_env: builds the environment; nothing in the dataset does.
        assets: folder of external assets, if the dataset used any.
        video: where to write recording (left) and replay (right) side by side, if anywhere; the replay alone if no
            pictures were recorded.
        progress: told of key frames done, and all.

    Raises:
        DatasetError: if the dataset is not there, not whole, or damaged.
        ConfigurationError: if it has no such episode.
    """
    load_check(root)
    _require_collected(Path(root))
    manifest = read_manifest(manifest_path(Path(root)), assets)
    recording = _read(Path(root), episode, manifest)
    if assets is not None:
        _require_content(manifest, recording.object_id, assets)
    env = make_env(manifest.spec.environment_of(category_of(recording.object_id)))
    try:
        changed = differing_parts(manifest.fingerprint, collection_fingerprint(env))
        seen, pictures, success = _run(env, recording, progress, look=video is not None)
    finally:
        env.close()
    if video is not None:
        _write_side_by_side(video, recording, pictures)
    return _compared(episode, recording, seen, success, changed)


def _require_collected(root: Path) -> None:
    """Raises `DatasetError` for a dataset that does not say how its scenes were made."""
    if manifest_path(root).exists():
        return
    columns = episode_table(root)
    told = columns["recorded"].to_pylist() if "recorded" in columns.column_names else [None]
    of_robot = all(each is not None for each in told)
    raise DatasetError(
        "These episodes were recorded on a robot: there is no scene to replay them in."
        if of_robot
        else "This dataset is put together of several, and does not say how each was collected.",
        got=f"{as_typed(root.absolute())}, without meta/collection.json",
        allowed="a dataset of `adamanip collect`, or a part of one",
        hint=f"adamanip view {as_typed(root.absolute())}"
        if of_robot
        else "adamanip replay with one of the datasets that were merged",
    )


def _compared(
    episode: int, recording: _Recording, seen: list[dict[str, NDArray[Any]]], success: bool, changed: tuple[str, ...]
) -> ReplayResult:
    return ReplayResult(
        episode=episode,
        object_id=recording.object_id,
        seed=recording.seed,
        key_frames=len(recording.columns[schema.EXECUTED]) - 1,
        replayed=len(seen) - 1,
        differences=_differences(recording, seen),
        success=success,
        recorded_success=recording.success,
        changed=changed,
    )


def _differences(recording: _Recording, seen: list[dict[str, NDArray[Any]]]) -> dict[str, float]:
    """Returns the largest difference of each column that is compared."""
    return {
        key: float(max(np.abs(frame[key] - recording.columns[key][t]).max() for t, frame in enumerate(seen)))
        for key in _COMPARED
    }


def _write_side_by_side(video: str | Path, recording: _Recording, pictures: list[Picture]) -> None:
    recorded = recording.columns.get(schema.FRONT_IMAGE)
    if recorded is not None:
        pictures = [np.concatenate([recorded[t], picture], axis=1) for t, picture in enumerate(pictures)]
    write_video(video, pictures, schema.FPS)


def _require_content(manifest: Manifest, object_id: str, assets: str | Path) -> None:
    if asset_hash(assets, object_id) != manifest.external_assets[object_id]:
        raise DatasetError(
            "The external asset is not the one that was recorded.",
            got=f"{object_id} in {assets}",
            allowed="a folder of the same content",
            hint="--assets with the folder of before",
        )


def _read(root: Path, episode: int, manifest: Manifest) -> _Recording:
    dataset = open_dataset(root, video_backend="pyav")
    if not 0 <= episode < dataset.num_episodes:
        raise ConfigurationError(
            "No such episode.", got=episode, allowed=f"0 to {dataset.num_episodes - 1}", hint="--episode 0"
        )
    row = episode_table(root).slice(episode, 1).to_pylist()[0]
    try:
        facts = _facts(row, manifest)
        first, end = (
            integer(0, len(dataset))(name, row.get(name)) for name in ("dataset_from_index", "dataset_to_index")
        )
        integer(2, _LONGEST)("number of rows", end - first)
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(
            "What the dataset tells of this episode cannot be.",
            got=f"episode {episode} of {root}: {error}",
            allowed="a row as `adamanip collect` writes it",
            hint="another episode, or collect the dataset again",
        ) from error
    frames = [dataset[index] for index in range(first, end)]
    columns = {key: np.stack([frame[key].numpy() for frame in frames]) for key in (*_COMPARED, schema.EXECUTED)}
    if schema.FRONT_IMAGE in frames[0]:
        images = np.stack([frame[schema.FRONT_IMAGE].numpy() for frame in frames]).transpose(0, 2, 3, 1)
        columns[schema.FRONT_IMAGE] = np.round(images * 255.0).astype(np.uint8)
    return _Recording(columns, **facts)


def _facts(row: dict[str, Any], manifest: Manifest) -> dict[str, Any]:
    """Returns what a replay needs of an episode's row; raises ValueError or KeyError for what cannot be."""
    if row["object_id"] not in manifest.spec.objects:
        raise ValueError("object_id is none of the collection's")
    return {
        "object_id": row["object_id"],
        "seed": integer(0, 2**63 - 1)("seed", row["seed"]),
        "success": flag("success", row["success"]),
        "overrides": optional(HIDDEN_STATE)("hidden_overrides", _parsed(row, "hidden_overrides")),
        "prefix": read_start(text(r"(?s).*", "text")("start", row["start"])),
    }


def _parsed(row: dict[str, Any], name: str) -> Any:
    return parse(text(r"(?s).*", "text")(name, row[name]))


def _run(
    env: SimulatedEnvironment, recording: _Recording, progress: Progress, *, look: bool
) -> tuple[list[dict[str, NDArray[Any]]], list[Picture], bool]:
    """Returns what was seen before each action and after the last, until the replayed episode ends, and success.

    Pictures (H, W, 3) only if someone wants to ``look``.
    """
    overrides = {} if recording.overrides is None else {"hidden_overrides": recording.overrides}
    observation, _ = env.reset(seed=recording.seed, options={"object_id": recording.object_id, **overrides})
    for action in recording.prefix:
        env.drive(action)
    if len(recording.prefix):
        observation = env.observe()
    actions = recording.columns[schema.EXECUTED][:-1]  # the terminal row's was never sent
    seen, success = [observation_columns(observation)], False
    pictures = [env.render()] if look else []
    for number, action in enumerate(actions):
        observation, _, _, truncated, info = env.step(action)
        seen.append(observation_columns(observation))
        pictures += [env.render()] if look else []
        success = success or bool(info["is_success"])
        progress(number + 1, len(actions))
        if truncated:
            break
    return seen, pictures, success


def check_replays(
    root: Path,
    episodes: Iterable[int],
    make_env: EnvFactory,
    *,
    tolerance: float,
    assets: Path | None = None,
    progress: CheckProgress = lambda stage, done, total: None,
) -> Report:
    """Replays episodes in the simulator; returns findings of kind ``replay``.

    Args:
        root: of a clean dataset that `adamanip collect` made.
        episodes: to be replayed.
        make_env: builds the environment.
        tolerance: largest difference in any column, in its own units.
        assets: folder of external assets, if the dataset was recorded with any.
        progress: told of stage ``replay``, episodes done, and all.
    """
    report, chosen = Report(), list(episodes)
    for done, number in enumerate(chosen, start=1):
        result = replay(root, number, make_env, assets=assets)
        if not result.agrees(tolerance):
            largest = max(result.differences, key=lambda key: result.differences[key])
            told = f"{largest} differs by {result.differences[largest]:.3g}, success {result.success}"
            changed = f"; since then {', '.join(result.changed)} changed" if result.changed else ""
            report.add("replay", told + changed, None, number)
        progress("replay", done, len(chosen))
    return report
