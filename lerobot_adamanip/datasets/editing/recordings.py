"""What a robot's recording has beside its rows and videos, when its episodes are put into another dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from lerobot_adamanip.datasets.editing.source import Source
from lerobot_adamanip.datasets.reading import as_typed
from lerobot_adamanip.hardware.features import CALIBRATIONS, KEY_FRAMES, SAFETY, is_dense
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError

_OF_ROBOT = (CALIBRATIONS, SAFETY)
"""Files that tell of the robot of all a recording's episodes."""


def require_same_calibrations(sources: Sequence[Source]) -> None:
    """Raises `DatasetError` for recordings of cameras that stood elsewhere: a dataset holds one calibration."""
    dense = [source for source in sources if is_dense(source.info["features"])]
    if len({tuple(_content(source.root / name) for name in _OF_ROBOT) for source in dense}) > 1:
        names = " ".join(as_typed(source.root) for source in dense)
        raise DatasetError(
            "These recordings have different camera calibrations or safety limits, and one can hold only one.",
            got=", ".join(source.root.name for source in dense),
            allowed=f"recordings with the same {' and '.join(_OF_ROBOT)}",
            hint=f"adamanip keyframes {names} --out BOTH converts each with its own",
        )


def describe_recording(out: Path, pieces: Sequence[tuple[Source, int]]) -> None:
    """Writes the calibration of a recording's cameras, and the known key frames of its episodes, if there are any.

    Args:
        out: folder of the new dataset.
        pieces: where its episodes come from, in its order.
    """
    first = pieces[0][0]
    if not is_dense(first.info["features"]):
        return
    for name in _OF_ROBOT:
        if (content := _content(first.root / name)) is not None:
            files.write_atomically(out / name, content)
    known = {source.root: _lines(source.root) for source, _ in pieces}
    lines = [known[source.root].get(episode) for source, episode in pieces]
    if all(line is not None for line in lines):
        files.write_atomically(out / KEY_FRAMES, b"".join(line + b"\n" for line in lines if line is not None))


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.exists() else None


def _lines(root: Path) -> Mapping[int, bytes]:
    return dict(enumerate((_content(root / KEY_FRAMES) or b"").splitlines()))
