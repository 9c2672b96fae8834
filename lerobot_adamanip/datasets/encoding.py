"""Prepare an episode for a dataset: its table, statistics and video, which depend on that episode only.

Worker processes do this, because it is most of the work of assembly. `appending` does the rest.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lerobot_adamanip.datasets.shards import RecordedEpisode, read_shard
from lerobot_adamanip.datasets.statistics import compute_statistics
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.jobs import Heartbeat

Features = Mapping[str, Mapping[str, Any]]
PLACE = ("index", "episode_index", "task_index")
"""Columns that depend on the episodes before."""
VIDEO = {"vcodec": "h264", "crf": 20, "preset": "veryfast", "g": 2}
ENCODER_THREADS = 1
"""With one thread, the same frames give the same file in every run."""


@dataclass(frozen=True, order=True)
class EpisodeFile:
    """An episode to prepare: its number in the dataset, and its file."""

    number: int
    path: Path


@dataclass(frozen=True)
class PreparedEpisode:
    """An episode ready to be appended.

    Attributes:
        record: description of the episode.
        table: rows as an Arrow stream; the columns `PLACE` are 0.
        stats: column -> statistics, without `PLACE`.
        videos: column -> file content.
    """

    record: dict[str, Any]
    table: bytes
    stats: dict[str, dict[str, Any]]
    videos: dict[str, bytes]


def quieten() -> None:
    """Silences the video library and progress bars."""
    import av
    import datasets

    av.logging.set_libav_level(av.logging.ERROR)
    datasets.disable_progress_bars()


def video_encoder() -> Any:
    """Returns LeRobot's configuration of the video encoder."""
    from lerobot.configs.video import RGBEncoderConfig

    return RGBEncoderConfig(**VIDEO)


_CODECS = {"h264": "h264", "hevc": "hevc", "av1": "libsvtav1"}
"""Codec of a video -> its encoder."""
_WORDS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow")
_ENCODER_OPTIONS: Mapping[str, json_fields.Check] = {
    "pix_fmt": json_fields.choice(("yuv420p", "yuv422p", "yuv444p")),
    "g": json_fields.integer(1, 1000),
    "crf": json_fields.number(0, 63),
    "preset": json_fields.either(json_fields.integer(0, 13), json_fields.choice(_WORDS)),
}
"""Encoder options that are read from a dataset, and their allowed values. Others are not passed on."""


def encoder_like(info: Mapping[str, Any]) -> Any:
    """Returns LeRobot's encoder configuration for frames that are appended to the video of a column's description.

    Raises:
        DatasetError: no encoder for this codec is allowed or installed.
    """
    from lerobot.configs.video import RGBEncoderConfig

    codec, options = str(info.get("video.codec")), {}
    for name, check in _ENCODER_OPTIONS.items():
        with contextlib.suppress(ValueError):
            options[name] = check(name, info.get(f"video.{name}"))
    try:
        return RGBEncoderConfig(vcodec=_CODECS[codec], **options)
    except (KeyError, ValueError) as error:
        raise DatasetError(
            "A video cannot be re-encoded.",
            got=f"codec {codec!r:.40}, {options}",
            allowed=f"codec {', '.join(_CODECS)}",
            hint="the dataset as it was before editing: its videos are copied",
        ) from error


@contextlib.contextmanager
def preparing_session(
    features: Features, fps: int
) -> Iterator[Callable[[EpisodeFile | bytes, Heartbeat], PreparedEpisode]]:
    """Yields a worker's function, which prepares an episode from a file or its content."""
    quieten()
    with tempfile.TemporaryDirectory(prefix="adamanip-") as scratch:
        sent = Path(scratch) / "episode.safetensors"

        def work(item: EpisodeFile | bytes, beat: Heartbeat) -> PreparedEpisode:
            if isinstance(item, bytes):
                sent.write_bytes(item)
            return prepare(read_shard(sent if isinstance(item, bytes) else item.path), features, fps, Path(scratch))

        yield work


def prepare(episode: RecordedEpisode, features: Features, fps: int, scratch: Path) -> PreparedEpisode:
    """Prepares one episode with the functions of LeRobot's writer, in the folder ``scratch``.

    ``features`` are those of the dataset, including LeRobot's own columns.
    """
    from lerobot.datasets.feature_utils import validate_frame
    from lerobot.datasets.image_writer import write_image

    for row in range(len(episode)):
        frame = {key: column[row] for key, column in episode.columns.items()}
        validate_frame({**frame, "task": episode.record["task"]}, dict(features))
    rows = _rows(episode, features, fps)
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        images = {key: Path(folder) / key for key, feature in features.items() if feature["dtype"] == "video"}
        paths = {}
        for key, pictures in images.items():
            pictures.mkdir()
            paths[key] = [str(pictures / f"frame-{number:06d}.png") for number in range(len(episode))]
            for path, image in zip(paths[key], episode.columns[key], strict=True):
                write_image(image, Path(path))
        stats = compute_statistics({key: {**rows, **paths}[key] for key in features if key not in PLACE}, features)
        videos = {key: _encode(pictures, fps) for key, pictures in images.items()}
    return PreparedEpisode(episode.record, _table(rows, features), stats, videos)


def _rows(episode: RecordedEpisode, features: Features, fps: int) -> dict[str, Any]:
    """Returns the columns as LeRobot's writer stacks them: columns of shape (1,) become scalars."""
    length = len(episode)
    arrays = {
        **episode.columns,
        **{key: np.zeros(length, np.int64) for key in PLACE},
        "timestamp": np.arange(length) / fps,
        "frame_index": np.arange(length),
    }
    return {
        key: arrays[key].reshape(length) if tuple(feature["shape"]) == (1,) else arrays[key]
        for key, feature in features.items()
        if feature["dtype"] != "video"
    }


def _table(rows: dict[str, Any], features: Features) -> bytes:
    import datasets
    from lerobot.datasets.feature_utils import get_hf_features_from_features

    columns = get_hf_features_from_features(dict(features))
    dataset = datasets.Dataset.from_dict({key: rows[key] for key in columns}, features=columns, split="train")
    table = dataset.with_format("arrow")[:]
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as stream:
        stream.write_table(table)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def _encode(folder: Path, fps: int) -> bytes:
    from lerobot.datasets.video_utils import encode_video_frames

    path = folder.with_suffix(".mp4")
    encode_video_frames(
        folder, path, fps, video_encoder=video_encoder(), encoder_threads=ENCODER_THREADS, overwrite=True
    )
    return path.read_bytes()
