"""The newest of something, in memory that two processes share: one writes, any number read, nobody waits.

Each mailbox has two slots. A writer fills the one that was not published last, then publishes it: a reader finds a
whole value at any time, also after the writer was killed in the middle of the next one. Every value carries its number
and a checksum, so that a slot which was overwritten while it was read is noticed, in whatever order memory is seen.
"""

from __future__ import annotations

import mmap
import os
import zlib
from collections.abc import Mapping

import numpy as np

from lerobot_adamanip.util.errors import RobotError

HEADER_WORDS = 3
"""Of a slot: number, length, checksum."""
TRIES = 1000
"""A reader is overtaken by the writer at most a few times in a row; more means that the memory is not a mailbox."""


class Mailbox:
    """Two slots and the number of the one that was published last.

    Args:
        memory: of `Mailbox.size` bytes, shared; zeros at first.
        capacity: largest value [bytes].
    """

    def __init__(self, memory: memoryview, capacity: int) -> None:
        self.capacity = capacity
        self._published = np.frombuffer(memory, np.uint64, 1)
        stride = self._stride(capacity)
        parts = [memory[8 + k * stride : 8 + (k + 1) * stride] for k in range(2)]
        self._headers = [np.frombuffer(part, np.uint64, HEADER_WORDS) for part in parts]
        self._bodies = [part[8 * HEADER_WORDS :] for part in parts]

    @staticmethod
    def _stride(capacity: int) -> int:
        return 8 * (HEADER_WORDS + (capacity + 7) // 8)

    @classmethod
    def size(cls, capacity: int) -> int:
        """Returns how many bytes a mailbox for values of up to ``capacity`` bytes takes."""
        return 8 + 2 * cls._stride(capacity)

    @property
    def number(self) -> int:
        """Of the value that was published last; 0 before the first. They count up by one."""
        return int(self._published[0])

    def write(self, value: bytes | memoryview) -> int:
        """Publishes a value and returns its number. One process and thread writes. Raises ValueError if too large."""
        size = len(value)
        if size > self.capacity:
            raise ValueError(f"{size} bytes, more than {self.capacity}")
        number = self.number + 1
        header, body = self._headers[number % 2], self._bodies[number % 2]
        header[0] = 0
        body[:size] = value
        header[1], header[2] = size, zlib.crc32(value)
        header[0] = number
        self._published[0] = number
        return number

    def read(self) -> tuple[int, bytes] | None:
        """Returns (number, value) of the newest; None before the first. Raises `RobotError` if it is never whole."""
        for _ in range(TRIES):
            number = self.number
            if number == 0:
                return None
            header = self._headers[number % 2]
            size, checksum = int(header[1]), int(header[2])
            value = bytes(self._bodies[number % 2][: min(size, self.capacity)])
            if int(header[0]) == number and zlib.crc32(value) == checksum:
                return number, value
        raise RobotError("A value in shared memory is never whole: it is written by two, or is no mailbox.")


class SharedMailboxes:
    """Named mailboxes in one anonymous piece of memory, which vanishes with the last process that holds it.

    Args:
        descriptor: of the memory, as another process made it; None makes it.
        capacities: name -> largest value [bytes]; the same in both processes.
    """

    def __init__(self, capacities: Mapping[str, int], descriptor: int | None = None) -> None:
        total = sum(Mailbox.size(capacity) for capacity in capacities.values())
        self.descriptor = os.memfd_create("arm") if descriptor is None else descriptor
        if descriptor is None:
            os.ftruncate(self.descriptor, total)
        self._memory = mmap.mmap(self.descriptor, total)
        view, offset = memoryview(self._memory), 0
        self._boxes: dict[str, Mailbox] = {}
        for name, capacity in capacities.items():
            size = Mailbox.size(capacity)
            self._boxes[name] = Mailbox(view[offset : offset + size], capacity)
            offset += size

    def __getitem__(self, name: str) -> Mailbox:
        return self._boxes[name]

    def close(self) -> None:
        """Gives the descriptor back; the memory goes when the mailboxes are forgotten. Idempotent."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1
