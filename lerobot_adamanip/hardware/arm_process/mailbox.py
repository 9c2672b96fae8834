"""Latest-value mailboxes in shared memory: one writer, any number of readers, no locks."""

from __future__ import annotations

import mmap
import os
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.hardware.arm_process.encoding import decode, encode
from lerobot_adamanip.util.errors import RobotError

HEADER_BYTES = 56
"""Header of seven words: the published number, then number, length and checksum of each slot."""
TRIES = 1000
"""Maximum read attempts. The writer overtakes a reader only a few times; more failures mean corrupt memory."""


class Mailbox:
    """Mailbox with the newest value of one writer.

    There are two slots. The writer fills the unpublished slot, then publishes it. So a reader always finds a complete
    value, even if the writer is killed during the next write. The checksum detects a slot that was overwritten
    during a read.

    Args:
        memory: shared memory of `Mailbox.size` bytes, initially zeros.
        capacity: maximum size of an encoded value [bytes].
    """

    def __init__(self, memory: memoryview, capacity: int) -> None:
        self._words = np.frombuffer(memory, np.uint64, 7)
        self._bodies = [memory[HEADER_BYTES + k * capacity : HEADER_BYTES + (k + 1) * capacity] for k in range(2)]
        self.capacity = capacity

    @staticmethod
    def size(capacity: int) -> int:
        """Returns the size of a mailbox [bytes], a multiple of eight."""
        return HEADER_BYTES + (2 * capacity + 7) // 8 * 8

    @property
    def number(self) -> int:
        """Number of the newest value: 0 before the first, then increasing by one."""
        return int(self._words[0])

    def write(self, value: object) -> int:
        """Publishes a value and returns its number. Only one thread may write. Raises ValueError for a large value."""
        content = encode(value)
        if len(content) > self.capacity:
            raise ValueError(f"{len(content)} bytes, more than {self.capacity}")
        number = self.number + 1
        header = self._header(number)
        header[0] = 0
        self._bodies[number % 2][: len(content)] = content
        header[1:] = len(content), zlib.crc32(content)
        header[0] = self._words[0] = number
        return number

    def read(self) -> tuple[int, Any] | None:
        """Returns (number, newest value); None before the first. Raises `RobotError` for corrupt memory."""
        for _ in range(TRIES):
            number = self.number
            if number == 0:
                return None
            written, size, checksum = map(int, self._header(number))
            content = bytes(self._bodies[number % 2][:size])
            if written == number == int(self._header(number)[0]) and zlib.crc32(content) == checksum:
                return number, decode(content, object)
        raise RobotError("A value in shared memory is never whole: two processes write it, or it is not a mailbox.")

    def _header(self, number: int) -> np.ndarray[Any, np.dtype[np.uint64]]:
        first = 1 + 3 * (number % 2)
        return self._words[first : first + 3]


def create_memory(capacities: Mapping[str, int]) -> int:
    """Returns the file descriptor of anonymous memory for mailboxes. The kernel frees it after its last user."""
    descriptor = os.memfd_create("arm")
    os.ftruncate(descriptor, sum(map(Mailbox.size, capacities.values())))
    return descriptor


def map_mailboxes(descriptor: int, capacities: Mapping[str, int]) -> dict[str, Mailbox]:
    """Returns the mailboxes by name. Pass the same ``capacities`` (name -> bytes) in both processes."""
    view = memoryview(mmap.mmap(descriptor, sum(map(Mailbox.size, capacities.values()))))
    boxes, offset = {}, 0
    for name, capacity in capacities.items():
        boxes[name] = Mailbox(view[offset : offset + Mailbox.size(capacity)], capacity)
        offset += Mailbox.size(capacity)
    return boxes
