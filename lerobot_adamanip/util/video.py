"""Videos: reading MP4 files of others, and export of frames for browsers."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def is_mp4(path: Path) -> bool:
    """Returns whether a file is empty or begins like an MP4 file."""
    with open(path, "rb") as file:
        head = file.read(8)
    return not head or head[4:] == b"ftyp"


def open_mp4(path: Path) -> Any:
    """Returns a PyAV container for reading.

    FFmpeg finds the format of a file by its content, not its name. A playlist would make it open other files.

    Raises:
        av.FFmpegError: it is no MP4 file.
    """
    import av

    return av.open(str(path), format="mp4")


def decoding_delay(path: Path) -> float:
    """Returns how long before it is shown the first frame of a video is decoded [s]; above 0 with B-frames."""
    with open_mp4(path) as container:
        packet = next(container.demux(video=0))
        return float((packet.pts - packet.dts) * packet.time_base)


def write_video(path: str | Path, frames: Iterable[NDArray[np.uint8]], fps: float) -> Path:
    """Writes (H, W, 3) RGB frames of one, even size as H.264; returns the path. Raises `ValueError` without frames."""
    import av

    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    pictures = list(frames)
    if not pictures:
        raise ValueError("A video needs at least one frame.")
    av.logging.set_libav_level(av.logging.ERROR)
    height, width = pictures[0].shape[:2]
    with av.open(str(target), "w") as container:
        stream: Any = container.add_stream("h264", Fraction(fps).limit_denominator(1000))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for picture in pictures:
            for packet in stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return target
