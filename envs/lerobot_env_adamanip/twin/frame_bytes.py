"""A frame of the twin as bytes in shared memory: who took which when, then colour, then depth."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.hardware.camera_frames import Frame

HEADER = struct.Struct("<dQII")
"""When it was taken (`time.perf_counter()` [s]), its number, height and width [px]."""
PIXEL_BYTES = 5
"""Three of colour and two of depth."""
FRONT_FRAMES = "front"
"""Mailbox of the front camera's frames."""
SUCCESS_BOX = "success"
"""Mailbox of one byte: whether the episode's task is done."""


@dataclass(frozen=True)
class TwinFrame:
    """What the twin's process saw: see `lerobot_adamanip.hardware.camera_frames.Frame`."""

    stamp: float
    number: int
    color: NDArray[np.uint8]
    depth: NDArray[np.uint16]

    def arrived(self, arrival: float) -> Frame:
        """Returns it as the recorder's process has it from ``arrival`` [s] on."""
        return Frame(self.stamp, arrival, self.color, self.depth, self.number)


def frame_capacity(size: int) -> int:
    """Returns the bytes of a square frame of so many pixels along a side."""
    return HEADER.size + PIXEL_BYTES * size * size


def pack_frame(frame: TwinFrame) -> bytes:
    """Returns the bytes that `unpack_frame` takes."""
    height, width = frame.depth.shape
    depth = frame.depth.astype("<u2", copy=False)
    return HEADER.pack(frame.stamp, frame.number, height, width) + frame.color.tobytes() + depth.tobytes()


def unpack_frame(content: bytes) -> TwinFrame:
    """Inverse of `pack_frame`. Raises ValueError for what is none."""
    stamp, number, height, width = HEADER.unpack_from(content)
    if len(content) != HEADER.size + PIXEL_BYTES * height * width:
        raise ValueError(f"{len(content)} bytes are no frame of {height} x {width} pixels")
    pixels = height * width
    color = np.frombuffer(content, np.uint8, 3 * pixels, HEADER.size).reshape(height, width, 3)
    depth = np.frombuffer(content, "<u2", pixels, HEADER.size + 3 * pixels).reshape(height, width)
    return TwinFrame(stamp, number, color, depth.astype(np.uint16, copy=False))
