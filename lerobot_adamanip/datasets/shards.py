"""Episode files (shards): one per finished episode, written atomically."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import is_image_column
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import parse

_PNG, _PNG_ENDS = ".png", ".png_ends"
"""Suffixes of an image column: concatenated PNG files, and the end of each."""
_RECORD = "record"


@dataclass(frozen=True)
class RecordedEpisode:
    """A recorded episode.

    Attributes:
        columns: dataset column -> (T, ...) array, as `schema.dataset_features` lists them.
        record: description of the episode (object, seed, hidden state, ...), JSON-able.
    """

    columns: dict[str, NDArray[Any]]
    record: dict[str, Any]

    def __len__(self) -> int:
        return len(self.columns[schema.ACTION])


def shard_bytes(episode: RecordedEpisode) -> bytes:
    """Returns an episode as safetensors, with images as PNG (lossless) and the record as JSON in the header."""
    tensors = {key: np.ascontiguousarray(value) for key, value in episode.columns.items()}
    for key in filter(is_image_column, episode.columns):
        images = [_png(image) for image in tensors.pop(key)]
        tensors[key + _PNG] = np.frombuffer(b"".join(images), dtype=np.uint8)
        tensors[key + _PNG_ENDS] = np.cumsum([len(image) for image in images]).astype(np.int64)
    header = {_RECORD: json.dumps(episode.record, sort_keys=True)}
    content: bytes = save(tensors, metadata=header)
    return content


def write_shard(path: Path, episode: RecordedEpisode) -> None:
    """Writes an episode durably."""
    write_shard_bytes(path, shard_bytes(episode))


def write_shard_bytes(path: Path, content: bytes) -> None:
    """Writes a serialised episode durably."""
    files.write_atomically(path, content, crash_points=("shard written", "shard in place"))


def read_shard(path: Path) -> RecordedEpisode:
    """Reads an episode; raises `DatasetError` if the file is missing or damaged."""
    try:
        with safe_open(path, framework="numpy") as file:
            columns = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a mapping)
            record = parse(file.metadata()[_RECORD])
        for key in [name.removesuffix(_PNG_ENDS) for name in columns if name.endswith(_PNG_ENDS)]:
            ends = columns.pop(key + _PNG_ENDS).tolist()
            png = columns.pop(key + _PNG).tobytes()
            images = [_unpng(png[start:end]) for start, end in zip([0, *ends[:-1]], ends, strict=True)]
            columns[key] = np.stack(images)
    except (OSError, SafetensorError, KeyError, ValueError, TypeError) as error:
        raise DatasetError(
            "Cannot read a recorded episode.",
            got=f"{path}: {error}",
            allowed="an intact episode file",
            hint="delete this file and run the same command or program again",
        ) from error
    return RecordedEpisode(columns, record)


def read_record(path: Path) -> dict[str, Any] | None:
    """Returns the record of an episode file; None if the file is missing or damaged."""
    try:
        with safe_open(path, framework="numpy") as file:
            record: dict[str, Any] = parse(file.metadata()[_RECORD])
    except (OSError, SafetensorError, KeyError, ValueError, TypeError):
        return None
    return record


def _png(image: NDArray[np.uint8]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()


def _unpng(content: bytes) -> NDArray[np.uint8]:
    with Image.open(io.BytesIO(content)) as image:
        return np.array(image.convert("RGB"))
