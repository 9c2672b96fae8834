"""Checks of ``meta/info.json``, texts and video files of a dataset that others made, before anything is passed on.

LeRobot, FFmpeg, cards and terminals interpret some values: encoder options, templates of paths, playlists, markup,
control characters. A value that neither LeRobot nor this project writes is refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.util.json_fields import (
    Check,
    choice,
    either,
    flag,
    integer,
    listing,
    mapping,
    number,
    optional,
    parse,
    text,
)
from lerobot_adamanip.util.video import is_mp4

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
"""LeRobot's templates. Datasets with other paths in their metadata are refused: those could point anywhere."""


VERSION = "v3.0"
"""LeRobot's format of datasets."""


class UntrustedValueError(ValueError):
    """A value that is not passed on to other libraries."""


class OtherFormatError(ValueError):
    """A dataset of another version of LeRobot's format."""


LINE = text(r"[^\x00-\x1f\x7f-\x9f]{0,1000}", "printable text of one line")
TASK = text(r"[^\x00-\x08\x0b-\x1f\x7f-\x9f]{1,2000}", "printable text")
WORD = text(r"[\w .:+/-]{0,100}", "a name")
"""A name that a card shows: no markup."""
_KEY = text(r"[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*", "a column")
_NUMBER = either(flag, number(-1e12, 1e12))
_NUMBERS = listing(either(_NUMBER, listing(number(-1e12, 1e12), 0, 16)), 0, 16)
_DETAIL = optional(either(_NUMBER, LINE, _NUMBERS, mapping(LINE, _NUMBERS, 16)))
_SIZE = optional(number(1e-6, 1e6))
_COUNT = integer(0, 2**40)
_NAMES = optional(either(listing(LINE, 0, 1_000_000), mapping(LINE, listing(LINE, 0, 1_000_000), 64)))
_EXTRA_OPTIONS: Mapping[str, Check] = {
    "x265-params": text(r"(lossless|bframes)=\d{1,2}(:(lossless|bframes)=\d{1,2})?", "lossless and bframes"),
    **dict.fromkeys(("tune", "profile"), text(r"[a-z0-9]{1,16}", "a word")),
}
"""Options of encoders that may be listed. Others can name files to write, as ``x264-params`` does with ``stats=``."""
_FIELDS: Mapping[str, Check] = {
    "total_frames": _COUNT,
    "total_episodes": _COUNT,
    "fps": integer(1, 10_000),
    "robot_type": optional(WORD),
    "chunks_size": optional(integer(1, 1_000_000)),
    "data_files_size_in_mb": _SIZE,
    "video_files_size_in_mb": _SIZE,
    "data_path": optional(choice((DATA_PATH,))),
    "video_path": optional(choice((VIDEO_PATH,))),
}
_NEEDED = ("total_frames", "total_episodes", "fps")
_MARKUP = re.compile(r"[<>`|\x00-\x1f\x7f-\x9f]|\]\(")
_OF_CARDS = ("object_id", "expert", "versions", "hidden_state", "recorded")
"""Columns of episodes that a card shows."""


def check_info(info: Any) -> dict[str, Any]:
    """Returns the content of ``meta/info.json``.

    Raises:
        OtherFormatError: the dataset has another format.
        UntrustedValueError: a value is not one that LeRobot or this project writes.
        ValueError: a field is missing.
    """
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise ValueError("it does not describe columns")
    if (version := info.get("codebase_version")) != VERSION:
        raise OtherFormatError(f"codebase_version is {version!r:.40}, not {VERSION!r}")
    if missing := [name for name in _NEEDED if name not in info]:
        raise ValueError(f"it lacks {', '.join(missing)}")
    try:
        for name, check in _FIELDS.items():
            if name in info:
                check(name, info[name])
        for key, feature in info["features"].items():
            _check_feature(_KEY("a column", key), feature)
    except ValueError as error:
        raise UntrustedValueError(str(error)) from None
    return info


def _check_feature(key: str, feature: object) -> None:
    """Raises ValueError for an invalid column."""
    if not isinstance(feature, dict):
        raise ValueError(f"{key} is no column")
    listing(integer(1, 1_000_000), 0, 4)(f"{key}.shape", feature.get("shape"))
    text(r"[a-z0-9]{1,16}", "a type")(f"{key}.dtype", feature.get("dtype"))
    _NAMES(f"{key}.names", feature.get("names"))
    details = dict(optional(mapping(WORD, lambda _, value: value, 64))(f"{key}.info", feature.get("info")) or {})
    extra = details.pop("video.extra_options", None)
    for name, value in optional(mapping(LINE, lambda _, value: value, 16))(f"{key}.info", extra or {}).items():
        if name not in _EXTRA_OPTIONS:
            raise ValueError(f"{key}.info.video.extra_options has an encoder's option {name!r}: {str(value)[:60]!r}")
        _EXTRA_OPTIONS[name](f"{key}.info.video.extra_options.{name}", value)
    for name, value in details.items():
        _DETAIL(f"{key}.info.{name}", value)


def plain_feature(feature: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what this project passes on of a column's description."""
    kept = {name: feature[name] for name in ("dtype", "shape", "names", "info") if name in feature}
    return {**kept, "shape": tuple(feature["shape"])}


def check_episode_text(column: str, value: object) -> None:
    """Checks a text in a column of ``meta/episodes``; raises `UntrustedValueError`."""
    if not isinstance(value, str):
        return
    try:
        text(r"(?s)[^\x00-\x08\x0b-\x1f\x7f-\x9f]*", "printable text")(column, value)
        if column in _OF_CARDS:
            _check_words(column, _parsed(value))
    except ValueError as error:
        raise UntrustedValueError(str(error)) from None


def _parsed(value: str) -> Any:
    try:
        return parse(value)
    except ValueError:
        return value


def _check_words(name: str, value: object) -> None:
    """Raises ValueError for a text in a JSON value that has markup."""
    if isinstance(value, Mapping):
        value = [*value.keys(), *value.values()]
    if isinstance(value, list):
        for each in value:
            _check_words(name, each)
    elif isinstance(value, str) and _MARKUP.search(value):
        raise ValueError(f"{name} has markup: {value[:80]!r}")


def check_video(path: Path) -> None:
    """Raises `UntrustedValueError` for a file that is no MP4, such as a playlist, whose entries FFmpeg would open."""
    if not is_mp4(path):
        raise UntrustedValueError(f"{path.name} is no MP4 file, so FFmpeg might read it as a list of other files")
