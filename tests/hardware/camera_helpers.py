"""Pictures whose number can be read off them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lerobot_adamanip.hardware.camera_frames import Frame, Intrinsics
from lerobot_adamanip.hardware.cameras.recording import Recording, write_recording

HEIGHT, WIDTH = 24, 32
INTRINSICS = Intrinsics(np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]]), np.zeros(5), WIDTH, HEIGHT)


def numbered_frame(number: int, stamp: float, height: int = HEIGHT, width: int = WIDTH) -> Frame:
    """A frame of which every pixel of colour and depth says its number."""
    color = np.zeros((height, width, 3), np.uint8)
    color[...] = (number % 256, 100, 200)
    return Frame(stamp, stamp, color, np.full((height, width), 500 + number, np.uint16), number)


def write_numbered(folder: Path, count: int, fps: int = 30, height: int = HEIGHT, width: int = WIDTH) -> Recording:
    """A recording of `numbered_frame`s."""
    frames = [numbered_frame(number, 5.0 + number / fps, height, width) for number in range(count)]
    return write_recording(folder, frames, camera="numbered", fps=fps, intrinsics=INTRINSICS)
