"""Encodes and decodes a short video as LeRobotDataset does, and prints the decoder's name.

Run it as `python -m lerobot_adamanip.cli.video_probe` in a separate process: codecs write long logs to stderr.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from lerobot.datasets.video_utils import decode_video_frames, encode_video_frames
from PIL import Image

SIDE = 64
"""Side length of the frames [px]."""


def encode_and_decode(folder: Path) -> None:
    """Writes four frames from black to bright. Raises RuntimeError if the first and last are not read back."""
    for i in range(4):
        Image.fromarray(np.full((SIDE, SIDE, 3), 60 * i, np.uint8)).save(folder / f"frame-{i:06d}.png")
    video = folder / "video.mp4"
    encode_video_frames(folder, video, fps=4)
    frames = decode_video_frames(video, [0.0, 0.75], tolerance_s=0.1)
    if float(frames[1].mean() - frames[0].mean()) < 0.5:
        raise RuntimeError("the decoded frames differ from the encoded ones")


def decoder() -> str:
    """Returns the name of LeRobot's video decoder on this machine."""
    try:
        import torchcodec  # noqa: F401  (loads FFmpeg's libraries, or fails)
    except Exception:
        return "PyAV (torchcodec finds no FFmpeg; LeRobot's commands print a long warning and continue)"
    return "torchcodec"


if __name__ == "__main__":
    try:
        with tempfile.TemporaryDirectory() as folder:
            encode_and_decode(Path(folder))
    except Exception as error:
        sys.exit(f"{type(error).__name__}: {error}".splitlines()[0])
    print(f"encoded and decoded with {decoder()}")
