"""A folder with frames of a camera: a PNG for each picture, and ``recording.json`` with their stamps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.calibration.file import check_intrinsics, check_name, to_json
from lerobot_adamanip.hardware.camera_frames import Frame, Intrinsics
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.files import write_atomically

FILE, VERSION = "recording.json", 1
MAX_FRAMES = 200_000
_CHECK = json_fields.table(
    {
        "version": json_fields.integer(VERSION, VERSION),
        "camera": check_name,
        "fps": json_fields.integer(1, 1000),
        "width": json_fields.integer(1, 20_000),
        "height": json_fields.integer(1, 20_000),
        "color": json_fields.flag,
        "depth": json_fields.flag,
        "stamps": json_fields.listing(json_fields.number(0, 1e7), 1, MAX_FRAMES),
        "intrinsics": json_fields.optional(check_intrinsics),
    }
)


@dataclass(frozen=True)
class Recording:
    """A folder of frames.

    Attributes:
        folder: that holds them.
        camera: serial number or name.
        fps: nominal rate [Hz].
        width, height: of the pictures [px].
        color, depth: whether there are pictures of these.
        stamps: of the frames, growing, from 0 [s].
        intrinsics: of the imager of depth, where known.
    """

    folder: Path
    camera: str
    fps: int
    width: int
    height: int
    color: bool
    depth: bool
    stamps: tuple[float, ...]
    intrinsics: Intrinsics | None

    @property
    def duration(self) -> float:
        """Time from the first frame to one after the last [s]."""
        return self.stamps[-1] + 1 / self.fps

    @classmethod
    def open(cls, folder: Path) -> Recording:
        """Reads ``recording.json``; raises `DatasetError` where it is missing or wrong."""
        try:
            found = _CHECK(FILE, json_fields.read(folder / FILE))
            if any(later <= earlier for earlier, later in zip(found["stamps"], found["stamps"][1:], strict=False)):
                raise ValueError("stamps do not grow")
        except (OSError, ValueError) as error:
            raise DatasetError(
                "No recording of a camera.",
                got=f"{folder}: {error}",
                allowed=f"a folder with {FILE} and its pictures",
                hint="the folder that write_recording wrote",
            ) from error
        del found["version"]
        return cls(folder, **found)

    def require(self, *, color: bool, depth: bool) -> None:
        """Raises `DatasetError` if wanted pictures are missing."""
        lacking = [name for name, wanted in (("color", color), ("depth", depth)) if wanted and not getattr(self, name)]
        if lacking:
            raise DatasetError(
                f"The recording {self.folder} has no {' and no '.join(lacking)}.",
                got=f"color {self.color}, depth {self.depth}",
                allowed="a recording with what is asked for",
                hint="use_rgb=false or use_depth=false",
            )

    def pictures(
        self, index: int, *, color: bool = True, depth: bool = True
    ) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint16] | None]:
        """Returns colour (H, W, 3) RGB and depth (H, W) [mm] of a frame, None for an unwanted one or none.

        Raises:
            DatasetError: a picture is missing, or of another size.
        """
        import cv2

        bgr = self._picture("color", index, np.uint8) if color and self.color else None
        rgb = None if bgr is None else np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
        return rgb, self._picture("depth", index, np.uint16) if depth and self.depth else None

    def _picture(self, kind: str, index: int, dtype: Any) -> NDArray[Any]:
        import cv2

        path = self.folder / f"{kind}_{index:06d}.png"
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if picture is None or picture.dtype != dtype or picture.shape[:2] != (self.height, self.width):
            got = "no picture" if picture is None else f"{picture.dtype} of {picture.shape[1]} x {picture.shape[0]}"
            raise DatasetError(
                f"The picture {path} cannot be played.",
                got=got,
                allowed=f"{np.dtype(dtype)} of {self.width} x {self.height}",
                hint="the recording as it was written",
            )
        return picture


def write_recording(
    folder: Path, frames: Iterable[Frame], *, camera: str, fps: int, intrinsics: Intrinsics | None = None
) -> Recording:
    """Writes frames of one size and kind into a new or empty folder, ``recording.json`` last.

    Raises:
        DatasetError: there are no frames, or the folder is not empty.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise DatasetError("A recording needs a folder of its own.", got=folder, allowed="an empty one", hint="another")
    stamps: list[float] = []
    first: Frame | None = None
    for index, frame in enumerate(frames):
        first = first or frame
        stamps.append(frame.stamp - first.stamp)
        _write_pictures(folder, index, frame)
    if first is None:
        raise DatasetError("A recording without frames.", got="none", allowed="at least one", hint="a longer one")
    picture = first.depth if first.depth is not None else first.color
    assert picture is not None
    described = {
        "version": VERSION,
        "camera": camera,
        "fps": fps,
        "width": picture.shape[1],
        "height": picture.shape[0],
        "color": first.color is not None,
        "depth": first.depth is not None,
        "stamps": stamps,
        "intrinsics": intrinsics,
    }
    write_atomically(folder / FILE, to_json(described))
    return Recording.open(folder)


def _write_pictures(folder: Path, index: int, frame: Frame) -> None:
    import cv2

    if frame.color is not None:
        cv2.imwrite(str(folder / f"color_{index:06d}.png"), np.ascontiguousarray(frame.color[..., ::-1]))
    if frame.depth is not None:
        cv2.imwrite(str(folder / f"depth_{index:06d}.png"), frame.depth)
