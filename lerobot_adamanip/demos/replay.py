"""Replaying a recorded episode in the simulator: does what was recorded happen again?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import schema
from lerobot_adamanip.demos.collection import read_manifest
from lerobot_adamanip.demos.loading import episode_table, open_dataset
from lerobot_adamanip.demos.video import write_video
from lerobot_adamanip.demos.worker import make_env
from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.observation import observation_columns
from lerobot_adamanip.rollout import KeyframeEnvironment

_COMPARED = (schema.STATE, schema.POINT_CLOUD, schema.EFFORT)


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
    """

    episode: int
    object_id: str
    seed: int
    key_frames: int
    replayed: int
    differences: dict[str, float]
    success: bool
    recorded_success: bool

    def agrees(self, tolerance: float) -> bool:
        """Returns whether the same thing happened, up to ``tolerance`` in every column."""
        same_end = self.success == self.recorded_success and self.replayed == self.key_frames
        return same_end and all(value <= tolerance for value in self.differences.values())


@dataclass(frozen=True)
class _Recording:
    columns: dict[str, NDArray[Any]]
    row: dict[str, Any]


def replay(root: str | Path, episode: int, *, video: str | Path | None = None) -> ReplayResult:
    """Runs an episode's recorded actions from its recorded seed and compares what is seen.

    Args:
        root: of a dataset that ``adamanip collect`` wrote.
        episode: index.
        video: where to write recording (left) and replay (right) side by side, if anywhere.

    Raises:
        DatasetError: if the dataset is not there, or not whole.
        ConfigurationError: if it has no such episode.
    """
    recording = _read(Path(root), episode)
    env = make_env(read_manifest(Path(root) / "meta" / "collection.json"), recording.row["object_id"])
    try:
        seen, success = _run(env, recording)
    finally:
        env.close()
    count = len(seen)
    differences = {
        key: float(max(np.abs(frame[key] - recording.columns[key][t]).max() for t, frame in enumerate(seen)))
        for key in _COMPARED
    }
    if video is not None:
        recorded = recording.columns[schema.FRONT_IMAGE]
        pairs = [np.concatenate([recorded[t], seen[t][schema.FRONT_IMAGE]], axis=1) for t in range(count)]
        write_video(video, pairs, schema.FPS)
    row = recording.row
    return ReplayResult(
        episode=episode,
        object_id=row["object_id"],
        seed=row["seed"],
        key_frames=row["length"],
        replayed=count,
        differences=differences,
        success=success,
        recorded_success=row["success"],
    )


def _read(root: Path, episode: int) -> _Recording:
    dataset = open_dataset(root, video_backend="pyav")
    if not 0 <= episode < dataset.num_episodes:
        raise ConfigurationError(
            "No such episode.", got=episode, allowed=f"0 to {dataset.num_episodes - 1}", hint="--episode 0"
        )
    row = episode_table(root).slice(episode, 1).to_pylist()[0]
    frames = [dataset[index] for index in range(row["dataset_from_index"], row["dataset_to_index"])]
    columns = {key: np.stack([frame[key].numpy() for frame in frames]) for key in (*_COMPARED, schema.ACTION)}
    images = np.stack([frame[schema.FRONT_IMAGE].numpy() for frame in frames]).transpose(0, 2, 3, 1)
    columns[schema.FRONT_IMAGE] = np.round(images * 255.0).astype(np.uint8)
    return _Recording(columns, row)


def _run(env: KeyframeEnvironment, recording: _Recording) -> tuple[list[dict[str, NDArray[Any]]], bool]:
    """Returns what was seen before each action, until the recording or the replayed episode ends, and success."""
    observation, _ = env.reset(seed=recording.row["seed"], options={"object_id": recording.row["object_id"]})
    seen, success = [], False
    for action in recording.columns[schema.ACTION]:
        seen.append(observation_columns(observation))
        observation, _, terminated, truncated, info = env.step(action)
        success = success or bool(info["is_success"])
        if terminated or truncated:
            break
    return seen, success
