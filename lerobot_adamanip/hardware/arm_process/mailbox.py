"""Messages between recorder and arm process: their bytes, and latest-value mailboxes in shared memory.

The bytes are JSON, a zero byte, then the raw bytes of all arrays. In the JSON, ``{"@": NAME, ...}`` is an array, a
tuple, or a registered dataclass or enumeration. The rest is plain.

No library of our dependencies does this. pyzmq has CONFLATE sockets for latest values, but only extras of LeRobot
install it. Pipes keep old values and block a writer whose reader hangs.
"""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import mmap
import os
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.util.errors import RobotError

TAG = "@"
HEADER_BYTES = 56
"""Header of seven words: the published number, then number, length and checksum of each slot."""
MAX_READS = 1000
"""Maximum read attempts. The writer overtakes a reader only a few times; more failures mean corrupt memory."""
_registered: dict[str, type] = {}


def message[Kind](kind: type[Kind]) -> type[Kind]:
    """Registers a dataclass or enumeration by its name. Both processes must import its module."""
    _registered[kind.__name__] = kind
    return kind


def encode(value: object) -> bytes:
    """Returns the bytes of a value. Raises TypeError for an unregistered class or a key that is not a string."""
    arrays: list[bytes] = []
    return json.dumps(_plain(value, arrays), separators=(",", ":")).encode() + b"\0" + b"".join(arrays)


def _plain(value: Any, arrays: list[bytes]) -> Any:
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if isinstance(value, np.ndarray):
        arrays.append(value.tobytes())
        return {TAG: "array", "dtype": value.dtype.str, "shape": value.shape}
    if isinstance(value, np.generic):
        return value.item()
    if kind is list:
        return [_plain(item, arrays) for item in value]
    if kind is tuple:
        return {TAG: "tuple", "items": [_plain(item, arrays) for item in value]}
    if isinstance(value, Mapping):
        if TAG in value or not all(isinstance(key, str) for key in value):
            raise TypeError(f"keys {list(value)} cannot be sent: keys must be strings other than {TAG!r}")
        return {key: _plain(item, arrays) for key, item in value.items()}
    if _registered.get(kind.__name__) is not kind:
        raise TypeError(f"{kind.__name__} cannot be sent: it is not registered by `message`")
    if isinstance(value, enum.Enum):
        return {TAG: kind.__name__, "value": value.value}
    fields = {field.name: _plain(getattr(value, field.name), arrays) for field in dataclasses.fields(value)}
    return {TAG: kind.__name__, **fields}


def decode[Value](data: bytes, kind: type[Value]) -> Value:
    """Returns the value passed to `encode`. Numbers and arrays keep their bits and types.

    Raises:
        RobotError: the bytes are truncated, or have an unknown class, another class or wrong fields.
    """
    head, zero, body = data.partition(b"\0")
    offset = 0

    def restore(item: dict[str, Any]) -> Any:
        nonlocal offset
        name = item.pop(TAG, None)
        if name is None:
            return item
        if name == "tuple":
            return tuple(item["items"])
        if name != "array":
            return _registered[name](**item)
        array = np.frombuffer(body, item["dtype"], math.prod(item["shape"]), offset)
        offset += array.nbytes
        return array.reshape(item["shape"]).copy()

    try:
        value = json.loads(head, object_hook=restore)
        if not zero or offset != len(body) or not isinstance(value, kind):
            raise ValueError(f"{type(value).__name__}, {len(body) - offset} bytes left over")
    except (ValueError, TypeError, KeyError) as error:
        got = f"{type(error).__name__}: {error}"
        raise RobotError("A message of the arm's process cannot be read.", got=got, allowed=kind.__name__) from None
    return value


class Mailbox:
    """Mailbox with the newest value of one writer, for any number of readers, without locks.

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
        for _ in range(MAX_READS):
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
