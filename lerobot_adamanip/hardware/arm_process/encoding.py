"""Message encoding between recorder and arm process: JSON, a zero byte, then the raw bytes of all arrays.

In the JSON, ``{"@": NAME, ...}`` is an array, a tuple, or a registered dataclass or enumeration. The rest is plain.
"""

from __future__ import annotations

import dataclasses
import enum
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.util.errors import RobotError

TAG = "@"
_registered: dict[str, type] = {}


def message[Kind](kind: type[Kind]) -> type[Kind]:
    """Registers a dataclass or enumeration by its name. Both processes must import its module."""
    _registered[kind.__name__] = kind
    return kind


def encode(value: object) -> bytes:
    """Returns the bytes of a value. Raises TypeError for an unregistered class or a key that is not a string."""
    arrays: list[bytes] = []
    return json.dumps(_plain(value, arrays), separators=(",", ":")).encode() + b"\0" + b"".join(arrays)


def decode[Value](data: bytes, kind: type[Value]) -> Value:
    """Returns the value passed to `encode`. Numbers and arrays keep their bits and types.

    Raises:
        RobotError: the bytes are truncated, or have an unknown class, another class or wrong fields.
    """
    head, zero, body = data.partition(b"\0")
    offset = 0

    def restored(found: dict[str, Any]) -> Any:
        nonlocal offset
        name = found.pop(TAG, None)
        if name is None:
            return found
        if name == "tuple":
            return tuple(found["items"])
        if name != "array":
            return _registered[name](**found)
        array = np.frombuffer(body, found["dtype"], math.prod(found["shape"]), offset)
        offset += array.nbytes
        return array.reshape(found["shape"]).copy()

    try:
        value = json.loads(head, object_hook=restored)
        if not zero or offset != len(body) or not isinstance(value, kind):
            raise ValueError(f"{type(value).__name__}, {len(body) - offset} bytes left over")
    except (ValueError, TypeError, KeyError) as error:
        told = f"{type(error).__name__}: {error}"
        raise RobotError("A message of the arm's process cannot be read.", got=told, allowed=kind.__name__) from None
    return value


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
        return [_plain(each, arrays) for each in value]
    if kind is tuple:
        return {TAG: "tuple", "items": [_plain(each, arrays) for each in value]}
    if isinstance(value, Mapping):
        if TAG in value or not all(isinstance(key, str) for key in value):
            raise TypeError(f"keys {list(value)} cannot be sent: keys must be strings other than {TAG!r}")
        return {key: _plain(each, arrays) for key, each in value.items()}
    if _registered.get(kind.__name__) is not kind:
        raise TypeError(f"{kind.__name__} cannot be sent: it is not registered by `message`")
    if isinstance(value, enum.Enum):
        return {TAG: kind.__name__, "value": value.value}
    parts = {each.name: _plain(getattr(value, each.name), arrays) for each in dataclasses.fields(value)}
    return {TAG: kind.__name__, **parts}
