"""Replay of recorded episodes in the simulator, compared with the recorded observations."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.collected_dataset import CollectedDataset, CollectedEpisode
from lerobot_adamanip.collection.record import EnvFactory, Environments
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.observation import observation_columns
from lerobot_adamanip.datasets.check.findings import Progress as CheckProgress
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.datasets.manifest import Manifest, asset_hash, differing_parts
from lerobot_adamanip.datasets.opening import as_typed
from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.video import write_video

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
        key_frames: number of recorded key frames.
        replayed: number of key frames until the replay ended.
        differences: column -> largest absolute difference over all key frames, in units of the column.
        success: whether the replay succeeded.
        recorded_success: whether the recording succeeded.
        changed: names of versions that differ between the recording and this program.
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
        progress: called with finished and total key frames.

    Raises:
        DatasetError: the dataset is missing, incomplete or damaged.
        ConfigurationError: the episode does not exist.
    """
    dataset = _open(Path(root), assets)
    with Environments(make_env, dataset.manifest.spec) as environments:
        result, pictures = _replayed(dataset, episode, environments, assets, progress, look=video is not None)
    if video is not None:
        _write_video(video, dataset, episode, pictures)
    return result


def _replayed(
    dataset: CollectedDataset,
    episode: int,
    environments: Environments,
    assets: str | Path | None,
    progress: Progress = lambda done, total: None,
    *,
    look: bool = False,
) -> tuple[ReplayResult, list[Picture]]:
    """Replays one episode of an open dataset; returns the comparison, and the pictures if ``look``."""
    if not 0 <= episode < len(dataset.rows):
        raise ConfigurationError(
            "No such episode.", got=episode, allowed=f"0 to {len(dataset.rows) - 1}", hint="--episode 0"
        )
    recorded = dataset.episode(episode)
    object_id = recorded.record["object_id"]
    _require_content(dataset.manifest, object_id, assets)
    env = environments.of(category_of(object_id))
    changed = differing_parts(dataset.manifest.versions, env.software_versions())
    seen, pictures, success = _run(env, recorded, progress, look=look)
    result = ReplayResult(
        episode=episode,
        object_id=recorded.record["object_id"],
        seed=recorded.record["seed"],
        key_frames=len(recorded.columns[schema.ACTION]) - 1,
        replayed=len(seen) - 1,
        differences={
            key: float(max(np.abs(frame[key] - recorded.columns[key][t]).max() for t, frame in enumerate(seen)))
            for key in _COMPARED
        },
        success=success,
        recorded_success=recorded.record["success"],
        changed=changed,
    )
    return result, pictures


def _open(root: Path, assets: str | Path | None) -> CollectedDataset:
    Dataset(root)
    if not manifest_path(root).exists():
        raise DatasetError(
            "This dataset has no scene metadata: it was recorded on a robot, or merged from several datasets.",
            got=f"{as_typed(root.absolute())}, without meta/collection.json",
            allowed="a dataset of `adamanip collect`, or a part of one",
            hint=f"one of the merged datasets; or adamanip view {as_typed(root.absolute())} --out episode.png",
        )
    return CollectedDataset.open(root, assets)


def _write_video(video: str | Path, dataset: CollectedDataset, episode: int, pictures: list[Picture]) -> None:
    if schema.FRONT_IMAGE in dataset.source.features:
        rows = open_dataset(dataset.source.root, episodes=[episode], video_backend="pyav", return_uint8=True)
        recorded = [rows[at][schema.FRONT_IMAGE].numpy().transpose(1, 2, 0) for at in range(len(rows))]
        pictures = [np.concatenate(pair, axis=1) for pair in zip(recorded, pictures, strict=False)]
    write_video(video, pictures, schema.FPS)


def _require_content(manifest: Manifest, object_id: str, assets: str | Path | None) -> None:
    if assets is not None and asset_hash(assets, object_id) != manifest.external_assets[object_id]:
        raise DatasetError(
            "The external asset differs from the recorded one.",
            got=f"{object_id} in {assets}",
            allowed="a folder with the same content",
            hint="--assets DIR with the folder of the recording",
        )


def _run(
    env: SimulatedEnvironment, recorded: CollectedEpisode, progress: Progress, *, look: bool
) -> tuple[list[Columns], list[Picture], bool]:
    """Replays an episode until it ends.

    Returns:
        Observations before each action and after the last; pictures (H, W, 3) of these moments, if ``look``; success.
    """
    observation = recorded.reset(env)
    for action in recorded.prefix:
        env.drive(action)
    if len(recorded.prefix):
        env.restart_episode()
        observation = env.observe()
    actions = recorded.columns[schema.EXECUTED][:-1]  # the terminal row's action was never sent
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
    """Replays episodes in the simulator and returns findings of kind ``replay``.

    Args:
        root: valid dataset from `adamanip collect`.
        episodes: indices of the episodes.
        make_env: builds the environment.
        tolerance: largest accepted difference in any column, in units of the column.
        assets: folder of external assets, if the dataset uses any.
        progress: called with the stage ``replay``, finished and total episodes.
    """
    report, chosen, dataset = Report(), list(episodes), _open(root, assets)
    with Environments(make_env, dataset.manifest.spec) as environments:
        for done, number in enumerate(chosen, start=1):
            result, _ = _replayed(dataset, number, environments, assets)
            if not result.agrees(tolerance):
                largest = max(result.differences, key=lambda key: result.differences[key])
                text = f"{largest} differs by {result.differences[largest]:.3g}, success {result.success}"
                changed = f"; since then {', '.join(result.changed)} changed" if result.changed else ""
                report.add("replay", text + changed, None, number)
            progress("replay", done, len(chosen))
    return report
