"""Encodes and decodes a short video with LeRobotDataset's functions and defaults; prints which decoder did it.

In a process of its own (`python -m lerobot_adamanip.cli.doctor.video_probe`), because codecs write pages to stderr.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

SIDE = 64
"""Side of the frames [pixels]."""


def encode_and_decode(folder: Path) -> str:
    """Writes four frames from black to bright into ``folder``, reads the first and the last back.

    Raises:
        Exception: whatever the codecs raise; RuntimeError if the frames read are not those written.
    """
    import numpy as np
    from lerobot.datasets.video_utils import decode_video_frames, encode_video_frames
    from PIL import Image

    for i in range(4):
        Image.fromarray(np.full((SIDE, SIDE, 3), 60 * i, np.uint8)).save(folder / f"frame-{i:06d}.png")
    video = folder / "video.mp4"
    encode_video_frames(folder, video, fps=4)
    frames = decode_video_frames(video, [0.0, 0.75], tolerance_s=0.1)
    if float(frames[1].mean() - frames[0].mean()) < 0.5:
        raise RuntimeError("the decoded frames are not those that were encoded")
    return _decoder()


def _decoder() -> str:
    try:
        import torchcodec  # noqa: F401  (loads FFmpeg's libraries, or fails)
    except Exception:
        return "PyAV (torchcodec finds no FFmpeg: LeRobot's commands print why, in some 90 lines, and go on)"
    return "torchcodec"


def main() -> int:
    """Exit status 0 if the frames survive."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            print(f"encoded and decoded with {encode_and_decode(Path(folder))}")
    except Exception as error:
        print(f"{type(error).__name__}: {error}".splitlines()[0], file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
