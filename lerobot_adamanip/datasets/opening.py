"""Open an untrusted dataset: checks of ``meta/info.json``, texts and video files, and the errors of opening.

LeRobot, FFmpeg, cards and terminals interpret some values: encoder options, templates of paths, playlists, markup,
control characters. A value that neither LeRobot nor this project writes is refused.
"""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.contract.schema import POINT_CLOUD, STATE
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.output_folder import INFO
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, names_of
from lerobot_adamanip.util.errors import DatasetError
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
    read,
    text,
)

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
_FORMER_LABEL = "label.success"
_OF_CARDS = ("object_id", "expert", "versions", "hidden_state", "recorded")
"""Columns of episodes that a card shows."""


def read_info(folder: Path) -> dict[str, Any]:
    """Returns ``meta/info.json`` after checking it.

    Raises:
        OSError: it does not exist.
        OtherFormatError: the dataset has another format.
        UntrustedValueError: a value is not one that LeRobot or this project writes.
        ValueError: it is not JSON, or lacks a field.
    """
    info: Any = read(folder / INFO)
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
    """Returns the fields of a column's description that are passed on to other libraries."""
    kept = {name: feature[name] for name in ("dtype", "shape", "names", "info") if name in feature}
    return {**kept, "shape": tuple(feature["shape"])}


def check_episode_text(column: str, value: object) -> None:
    """Checks a text in a column of ``meta/episodes``; raises `UntrustedValueError`."""
    if not isinstance(value, str):
        return
    try:
        text(r"(?s)[^\x00-\x08\x0b-\x1f\x7f-\x9f]*", "printable text")(column, value)
        if column in _OF_CARDS:
            with contextlib.suppress(ValueError):
                value = parse(value)
            _check_words(column, value)
    except ValueError as error:
        raise UntrustedValueError(str(error)) from None


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
    with open(path, "rb") as file:
        head = file.read(8)
    if head and head[4:] != b"ftyp":
        raise UntrustedValueError(f"{path.name} is no MP4 file, so FFmpeg might read it as a list of other files")


# Opening --------------------------------------------------------------------------------------------------------------


def checked_info(folder: Path) -> dict[str, Any]:
    """Returns `read_info` of an absolute folder; raises `DatasetError` for each of its errors."""
    require_dataset(folder)
    try:
        info = read_info(folder)
    except UntrustedValueError as error:
        raise untrusted(folder, error) from error
    except OtherFormatError as error:
        raise DatasetError(
            "This dataset has another format.",
            got=f"{as_typed(folder)}: {error}",
            allowed=f"format {VERSION} of LeRobot",
            hint=f"{conversion_command(folder)}, which converts format v2.1",
        ) from error
    except (OSError, ValueError) as error:
        raise damaged(folder, f"{INFO}: {error}") from error
    if _FORMER_LABEL in names_of(info["features"].get(STATE)):
        raise DatasetError(
            "This recording is of an earlier version: its state holds a clock and the result.",
            got=f"{as_typed(folder)}: {STATE} with {_FORMER_LABEL}",
            allowed="a state of tool pose and joints only",
            hint="record it again",
        )
    return info


def conversion_command(folder: Path) -> str:
    """Returns LeRobot's command that converts a dataset from format v2.1."""
    module = "lerobot.scripts.convert_dataset_v21_to_v30"
    return f"python -m {module} --repo-id=local/{folder.name} --root={as_typed(folder)} --push-to-hub=false"


def require_dataset(root: str | Path) -> Path:
    """Returns the absolute folder of a dataset, complete or not.

    Raises:
        DatasetError: there is none; it names an unfinished collection, or datasets in the folder.
    """
    folder = Path(root).absolute()
    if (folder / INFO).exists() or any(folder.glob("data/*/*.parquet")):
        return folder
    partial, shown = CollectionPaths(folder.resolve()), as_typed(folder)
    if partial.partial.is_dir():
        done = len(list(partial.episodes.glob("*.safetensors")))
        raise DatasetError(
            "This dataset is not finished.",
            got=f"{done} episodes in {partial.partial}",
            allowed=f"a complete dataset at {folder}",
            hint="the same `adamanip collect` command; it resumes",
        )
    got, hint = shown, f"adamanip collect {shown} --category safe"
    if folder.is_dir():
        inside = sorted(as_typed(path.parent.parent) for path in folder.glob(f"*/{INFO}"))
        got = f"{shown}, a folder with other files" if any(folder.iterdir()) else f"{shown}, an empty folder"
        hint = f"{inside[0]}, which is a dataset" if inside else "another folder"
    elif folder.exists():
        got, hint = f"{shown}, a file", "the folder of a dataset"
    raise DatasetError("There is no dataset.", got=got, allowed=f"a folder with {INFO}", hint=hint)


def as_typed(folder: Path) -> str:
    """Returns a path as a user types it: relative if it is below the working directory, quoted if it needs to be."""
    here = Path.cwd()
    return shlex.quote(str(folder.relative_to(here) if folder.is_relative_to(here) else folder))


def first_line(error: BaseException) -> str:
    """Returns the first line of an error's message; without a message, its type."""
    return str(error).partition("\n")[0][:200] or type(error).__name__


def recording_error(folder: Path, features: Mapping[str, Any]) -> DatasetError:
    """Returns the error for a robot's recording where a dataset of key frames is needed."""
    name = as_typed(folder)
    hint = f"adamanip keyframes {name} --out {name}-keyframes"
    if not any(key.endswith(DEPTH_SUFFIX) for key in features):
        hint = "lerobot-record --robot.depth=true: this recording has no depth to make clouds of"
    return DatasetError(
        "This is a recording of ticks, not a dataset of key frames.",
        got=f"{name}, without {POINT_CLOUD}",
        allowed="a dataset of `adamanip collect` or `adamanip keyframes`",
        hint=hint,
    )


def damaged(folder: Path, problem: object) -> DatasetError:
    """Returns the error for a half written or damaged dataset."""
    return DatasetError(
        "This dataset is half written or damaged.",
        got=f"{folder}: {problem}",
        allowed="complete Parquet, JSON and video files",
        hint=f"adamanip check {as_typed(folder)} --repair, which repairs counts and statistics and lists other damage",
    )


def untrusted(folder: Path, problem: object) -> DatasetError:
    """Returns the error for a value of a dataset that could make a library do something else."""
    return DatasetError(
        "This dataset has a value that is not passed on to other programs.",
        got=f"{folder}: {problem}"[:400],
        allowed="values that LeRobot or `adamanip` writes",
        hint="a copy of the dataset from a source that you trust",
    )
