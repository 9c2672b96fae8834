"""Reading of MP4 files of others."""

from __future__ import annotations

from pathlib import Path
from typing import Any


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
