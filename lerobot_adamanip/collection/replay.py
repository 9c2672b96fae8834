"""Replay of recorded episodes in the simulator, compared with the recorded observations."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.record import EnvFactory, Environments, reset_scene
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.observation import observation_columns
from lerobot_adamanip.datasets.check.findings import Progress as CheckProgress
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.datasets.episode import read_start
from lerobot_adamanip.datasets.manifest import Manifest, asset_hash, differing_parts
from lerobot_adamanip.datasets.opening import as_typed
from lerobot_adamanip.datasets.shards import RecordedEpisode
from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util.errors import DatasetError

Picture = NDArray[np.uint8]
Columns = dict[str, NDArray[Any]]
_COMPARED = (schema.STATE, schema.POINT_CLOUD, schema.EFFORT)
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class ReplayResult:
    """Comparison of a replay with its recording.

    Attributes:
        episode: index of the episode in the dataset.
        object_id: id of the object.
        seed: seed of the episode.
        key_frames: number of recorded key frames, or of steps at control rate.
        replayed: their number until the replay ended.
        differences: column -> largest absolute difference over all of them, in units of the column.
        success: whether the replay succeeded.
        recorded_success: whether the recording succeeded.
        changed: names of versions that differ between the recording and this program.
        unit: ``key frames``, or ``steps`` at control rate.
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
    unit: str = "key frames"

    def agrees(self, tolerance: float) -> bool:
        """Returns whether the replay matches the recording, up to ``tolerance`` in every column."""
        same_end = self.success == self.recorded_success and self.replayed == self.key_frames
        return same_end and all(value <= tolerance for value in self.differences.values())


def replay(
    root: str | Path,
    episode: int,
    make_env: EnvFactory,
    *,
    assets: str | Path | None = None,
    video: str | Path | None = None,
    progress: Progress = lambda done, total: None,
) -> ReplayResult:
    """Runs an episode's recorded actions from its recorded start and compares the observations.

    Args:
        root: dataset from ``adamanip collect``.
        episode: index of the episode.
        make_env: builds the environment; it never comes from the dataset.
        assets: folder of external assets, if any were used.
        video: file for a video of recording (left), if it has pictures, and replay (right); None for no video.
        progress: called with finished and total actions.

    Raises:
        DatasetError: the dataset is missing, incomplete or damaged.
        ConfigurationError: the episode does not exist.
    """
    dataset, manifest = _open(Path(root), assets)
    pictures: list[Picture] | None = None if video is None else []
    with Environments(make_env, manifest.spec) as environments:
        result = _replay(dataset, manifest, episode, environments, progress=progress, pictures=pictures)
    if video is not None and pictures is not None:
        if schema.FRONT_IMAGE in dataset.features:
            rows = open_dataset(dataset.root, episodes=[episode], video_backend="pyav", return_uint8=True)
            recorded = [rows[at][schema.FRONT_IMAGE].numpy().transpose(1, 2, 0) for at in range(len(rows))]
            pictures = [np.concatenate(pair, axis=1) for pair in zip(recorded, pictures, strict=False)]
        from lerobot.utils.io_utils import write_video

        Path(video).parent.mkdir(parents=True, exist_ok=True)
        write_video(video, pictures, dataset.fps)
    return result


def check_replays(
    root: Path,
    episodes: Iterable[int],
    make_env: EnvFactory,
    *,
    tolerance: float,
    assets: Path | None = None,
    progress: CheckProgress = lambda stage, done, total: None,
) -> Report:
    """Replays episodes in the simulator and returns findings of kind ``replay``.

    Args:
        root: valid dataset from `adamanip collect`.
        episodes: indices of the episodes.
        make_env: builds the environment.
        tolerance: largest accepted difference in any column, in units of the column.
        assets: folder of external assets, if the dataset uses any.
        progress: called with the stage ``replay``, finished and total episodes.
    """
    report, indices, (dataset, manifest) = Report(), list(episodes), _open(root, assets)
    with Environments(make_env, manifest.spec) as environments:
        for done, index in enumerate(indices, start=1):
            result = _replay(dataset, manifest, index, environments)
            if not result.agrees(tolerance):
                largest = max(result.differences, key=lambda key: np.nan_to_num(result.differences[key], nan=np.inf))
                text = f"{largest} differs by {result.differences[largest]:.3g}, success {result.success}"
                changed = f"; since then {', '.join(result.changed)} changed" if result.changed else ""
                report.add("replay", text + changed, None, index)
            progress("replay", done, len(indices))
    return report


def _open(root: Path, assets: str | Path | None) -> tuple[Dataset, Manifest]:
    dataset = Dataset(root)
    if not manifest_path(root).exists():
        raise DatasetError(
            "This dataset has no scene metadata: it was recorded on a robot, merged from several datasets, "
            "or made by `adamanip keyframes`.",
            got=f"{as_typed(root.absolute())}, without meta/collection.json",
            allowed="a dataset of `adamanip collect`, or a part of one",
            hint=f"one of the merged datasets; or adamanip view {as_typed(root.absolute())} --out episode.png",
        )
    return dataset, dataset.manifest(assets)


def _replay(
    dataset: Dataset,
    manifest: Manifest,
    index: int,
    environments: Environments,
    *,
    progress: Progress = lambda done, total: None,
    pictures: list[Picture] | None = None,
) -> ReplayResult:
    """Replays one episode of an open dataset; returns the comparison, and appends to ``pictures``."""
    episode = dataset.recorded(index, manifest)
    object_id, assets = episode.record["object_id"], manifest.spec.environment.assets
    if assets is not None and asset_hash(assets, object_id) != manifest.external_assets[object_id]:
        raise DatasetError(
            "The external asset differs from the recorded one.",
            got=f"{object_id} in {assets}",
            allowed="a folder with the same content",
            hint="--assets DIR with the folder of the recording",
        )
    env = environments.of(category_of(object_id))
    observations, success = _run(env, episode, progress, pictures)
    return ReplayResult(
        episode=index,
        object_id=object_id,
        seed=episode.record["seed"],
        key_frames=len(episode) - 1,
        replayed=len(observations) - 1,
        differences={
            # `max` of floats would drop a NaN.
            key: float(np.max([np.abs(row[key] - episode.columns[key][t]).max() for t, row in enumerate(observations)]))
            for key in _COMPARED
            if key in episode.columns
        },
        success=success,
        recorded_success=episode.record["success"],
        changed=differing_parts(manifest.versions, env.software_versions()),
        unit="steps" if manifest.spec.environment.is_dense else "key frames",
    )


def _run(
    env: SimulatedEnvironment, episode: RecordedEpisode, progress: Progress, pictures: list[Picture] | None
) -> tuple[list[Columns], bool]:
    """Replays an episode until it ends.

    Args:
        env: environment of the episode's category.
        episode: the episode.
        progress: called with finished and total key frames.
        pictures: for a picture (H, W, 3) before each action and after the last; None for none.

    Returns:
        Observations of these moments, and the success.
    """
    record = episode.record
    observation = reset_scene(env, record["object_id"], record["seed"], record["hidden_overrides"])
    prefix = read_start(record["start"])
    for action in prefix:
        env.drive(action)
    if len(prefix):
        env.restart_episode()
        observation = env.observe()
    actions = episode.columns[schema.EXECUTED][:-1]  # the terminal row's action was never sent
    observations, success = [observation_columns(observation)], False
    if pictures is not None:
        pictures.append(env.render())
    for number, action in enumerate(actions):
        observation, _, _, truncated, info = env.step(action)
        observations.append(observation_columns(observation))
        if pictures is not None:
            pictures.append(env.render())
        success = success or bool(info["is_success"])
        progress(number + 1, len(actions))
        if truncated:
            break
    return observations, success
