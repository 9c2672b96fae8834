"""Key frames of simulated episodes at control rate: `adamanip keyframes` of a dataset of `adamanip collect`."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.assemble import Contents, assemble
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import CAMERAS, image_column
from lerobot_adamanip.contract.control import KEYFRAME
from lerobot_adamanip.contract.keyframes import CLOSED_HAND, Outcome
from lerobot_adamanip.contract.memory import instruction_of
from lerobot_adamanip.datasets.dataset import Dataset, Episode, open_dataset
from lerobot_adamanip.datasets.dense import is_dense_collection
from lerobot_adamanip.datasets.episode import EpisodeDescription
from lerobot_adamanip.datasets.opening import as_typed, read_info
from lerobot_adamanip.datasets.output_folder import CONVERTING, owned_output
from lerobot_adamanip.datasets.pose_statistics import keep_unscaled_poses
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.shards import RecordedEpisode, write_shard
from lerobot_adamanip.episode.dense import TICK
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.tries import OPENING_TICKS, REST_TICKS
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Columns = Mapping[str, NDArray[Any]]
Progress = Callable[[str, int, int], None]
"""Called with stage (``convert``, ``assemble``), finished and total episodes."""


def dense_collections(roots: Iterable[Path]) -> list[Path]:
    """Returns the folders that hold simulated datasets at control rate; others are for their own readers to judge."""
    found = []
    for root in roots:
        try:
            if is_dense_collection(read_info(root.absolute())["features"]):
                found.append(root)
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return found


def require_one_source(sources: Iterable[Path]) -> Path:
    """Returns the only source; raises `ConfigurationError` if there are several."""
    first, *others = sources
    if others:
        raise ConfigurationError(
            "A simulated dataset at control rate is converted alone.",
            got=", ".join(map(str, (first, *others))),
            allowed="one such dataset, or recordings of a robot with datasets of key frames",
            hint=f"adamanip keyframes {as_typed(first)} --out A; then adamanip merge A B --out BOTH",
        )
    return first


def write_key_frames(
    root: Path,
    out: Path,
    *,
    images: bool = True,
    repo_id: str | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> tuple[int, int]:
    """Writes the key frames of a dense dataset; returns the numbers of episodes and of key frames.

    Args:
        root: dataset of `adamanip collect --control dense` with clouds, effort and the full state.
        out: new folder; it must not exist.
        images: whether to keep pictures.
        repo_id: ``local/<folder name>`` by default.
        progress: called after each episode.

    Raises:
        DatasetError: the dataset is damaged or lacks columns that key frames have, or ``out`` exists.
    """
    require_repo_id(repo_id)
    source = Dataset(root)
    environment = _environment(source, images=images)
    with owned_output(out, CONVERTING) as output:
        output.require_free()
        output.require_room()
        folder, shards, count = output.fresh("episodes"), [], 0
        folder.mkdir()
        for done, episode in enumerate(source.episodes, start=1):
            converted = _converted(source, episode, environment)
            shards.append(folder / f"{episode.number:06d}.safetensors")
            write_shard(shards[-1], converted)
            count += len(converted) - 1
            progress("convert", done, len(source))
        contents = Contents(shards, environment, repo_id or f"local/{output.root.name}")
        built = assemble(output.fresh("dataset"), output.root.name, contents, functools.partial(progress, "assemble"))
        keep_unscaled_poses(built, [source])
        output.publish(built)
    return len(shards), count


def _environment(source: Dataset, *, images: bool) -> EnvironmentOptions:
    """Returns the options whose key-frame columns the dataset can fill; raises `DatasetError` for missing columns."""
    shapes = {key: tuple(feature["shape"]) for key, feature in source.features.items()}
    lacking = [f"no {key}" for key in (schema.POINT_CLOUD, schema.EFFORT) if key not in shapes]
    if shapes[schema.STATE] != (schema.STATE_DIM,):
        lacking.append(f"{schema.STATE} of {shapes[schema.STATE][0]} numbers")
    if lacking:
        raise DatasetError(
            "This dataset lacks columns that key frames have.",
            got=f"{source.root.name}: {', '.join(lacking)}",
            allowed="clouds, effort and the full state",
            hint="adamanip collect DIR --control dense --cloud --effort --state full",
        )
    cameras = tuple(name for name in CAMERAS if images and image_column(name) in shapes)
    return EnvironmentOptions(
        category_of(source.descriptions()[0].object_id),
        control=KEYFRAME,
        num_points=shapes[schema.POINT_CLOUD][0] // 3,
        image_size=shapes[image_column(cameras[0])][0] if cameras else schema.IMAGE_SIZE,
        observe_images=bool(cameras),
        cameras=cameras or None,
        workspace=source.workspace,
    )


def _converted(source: Dataset, episode: Episode, environment: EnvironmentOptions) -> RecordedEpisode:
    columns = source.columns(episode)
    columns = {key: values.reshape(len(values), -1) for key, values in columns.items() if key in source.features}
    rows, converted = key_frame_columns(columns, source.fps)
    if environment.observe_images:
        frames = open_dataset(source.root, episodes=[episode.number], video_backend="pyav", return_uint8=True)
        shown = [frames[int(row)] for row in rows]
        for key in map(image_column, environment.observed_cameras):
            converted[key] = np.stack([frame[key].numpy().transpose(1, 2, 0) for frame in shown])
    description = EpisodeDescription.from_columns(episode.row)
    tasks = dict.fromkeys(map(instruction_of, episode.tasks))
    return RecordedEpisode(converted, description.record(", ".join(tasks)))


def key_frame_columns(columns: Columns, fps: int) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]]]:
    """Returns the key frames of a dense episode: their first rows and the last one, (K + 1,), and their columns.

    A key frame has the label of its longest try, as `KeyFrameLabeler` defines it. One that the end of the episode cut
    off has the outcome ``TIMEOUT``.

    Args:
        columns: the (T + 1, ...) columns of the episode, without pictures; the last row is terminal.
        fps: rows per second.
    """
    terminal = len(columns[schema.ACTION]) - 1
    if not np.array_equal(columns[schema.ACTION], columns.get(schema.EXECUTED, columns[schema.ACTION])):
        raise DatasetError(
            "This dataset has no key frames: something else than its actions was sent.",
            got=f"{schema.EXECUTED} that differs from {schema.ACTION}",
            allowed="demonstrations of an expert without mistakes",
            hint="adamanip collect DIR with the same options, without --control dense",
        )
    outcomes = columns[schema.OUTCOME][:terminal, 0]
    ends = np.flatnonzero(outcomes != schema.GOES_ON)
    ends = ends if len(ends) and ends[-1] == terminal - 1 else np.append(ends, terminal - 1)
    starts = np.append(0, ends[:-1] + 1)
    rows = np.append(starts, terminal)
    labels = [_label(columns, start, end + 1, fps) for start, end in zip(starts, ends, strict=True)]
    observed = (schema.POINT_CLOUD, schema.STATE, schema.EFFORT, schema.JOINTS)
    goals = columns[schema.KEY_FRAME][rows].copy()
    pose = schema.GRIPPER_DIM
    goals[-1, :pose] = columns[schema.STATE][terminal, :pose]
    ended = np.where(outcomes[ends] == schema.GOES_ON, Outcome.TIMEOUT, outcomes[ends])
    values: dict[str, Any] = {
        schema.PHASE: columns[schema.PHASE][rows, 0],
        schema.TRIAL: columns[schema.TRIAL][rows, 0],
        schema.OUTCOME: [*ended, Outcome.REACHED],
        schema.TRIED: [*(tried for tried, _, _ in labels), -1],
        schema.FAILED: [*(failed for _, failed, _ in labels), False],
        schema.PROGRESS: [*(progress for _, _, progress in labels), 0.0],
        schema.SUCCESS: columns[schema.SUCCESS][np.append(ends, terminal), 0],
        schema.DONE: [*(False for _ in labels), True],
    }
    return rows, {
        **{key: columns[key][rows].astype(np.float32) for key in observed},
        schema.ACTION: goals.astype(np.float32),
        schema.EXECUTED: goals.astype(np.float32),
        **{key: np.array(value, schema.LABEL_DTYPES[key])[:, None] for key, value in values.items()},
    }


def _label(columns: Columns, start: int, end: int, fps: int) -> tuple[int, bool, float]:
    """Returns joint, failure and progress of the longest try in the rows of a key frame; -1 without one."""
    tries = np.concatenate([columns[key] for key in (schema.TRIED, schema.DIRECTION, schema.TRIAL)], axis=1)
    present = [tuple(row) for row in tries[start:end].tolist() if row[0] >= 0]
    if not present:
        return -1, False, 0.0
    longest = max(dict.fromkeys(present), key=present.count)
    goes_on = start > 0 and longest == tuple(tries[start - 1].tolist())
    is_open = columns[schema.KEY_FRAME][start, schema.GRIPPER_DIM] > CLOSED_HAND
    least = 0 if not goes_on else OPENING_TICKS if is_open else REST_TICKS
    if present.count(longest) <= least * TICK * fps:
        return -1, False, 0.0
    rows = start + np.flatnonzero((tries[start:end] == longest).all(axis=1))
    return longest[0], bool(columns[schema.FAILED][rows[-1], 0]), float(columns[schema.PROGRESS][rows, 0].sum())
