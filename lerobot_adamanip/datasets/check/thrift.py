"""Thrift's compact protocol, as much as the footer of a Parquet file needs: structures in, the same structures out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(1, 13)
Struct = dict[int, tuple[int, Any]]
"""Number of a field -> its type and value. A list's value is (type of its entries, entries)."""
_DEEPEST = 32


@dataclass
class Reader:
    """Reads structures from bytes; raises ValueError where there are none, and IndexError where they end early."""

    data: bytes
    at: int = 0

    def struct(self, depth: int = 0) -> Struct:
        """Reads a structure."""
        if depth > _DEEPEST:
            raise ValueError("nested too deeply")
        fields: Struct = {}
        number = 0
        while (head := self._byte()) != 0:
            number = number + (head >> 4) if head >> 4 else self._signed()
            kind = head & 15
            value = kind == TRUE if kind in (TRUE, FALSE) else self._value(kind, depth)
            fields[number] = (kind, value)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (I16, I32, I64):
            return self._signed()
        if kind == BINARY:
            return self._bytes(self._unsigned())
        if kind in (LIST, SET):
            head = self._byte()
            size = head >> 4 if head >> 4 != 15 else self._unsigned()
            if size > len(self.data) - self.at:
                raise ValueError("a list longer than the file")
            return head & 15, [self._value(head & 15, depth + 1) for _ in range(size)]
        if kind == STRUCT:
            return self.struct(depth + 1)
        if kind in (TRUE, FALSE, BYTE):
            return self._byte()
        if kind == DOUBLE:
            return self._bytes(8)
        raise ValueError(f"no type {kind}")

    def _byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def _bytes(self, size: int) -> bytes:
        if self.at + size > len(self.data):
            raise IndexError("the end")
        self.at += size
        return self.data[self.at - size : self.at]

    def _unsigned(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7
            if shift > 63:
                raise ValueError("no number")

    def _signed(self) -> int:
        value = self._unsigned()
        return (value >> 1) ^ -(value & 1)


@dataclass
class Writer:
    """Writes structures."""

    data: bytearray = field(default_factory=bytearray)

    def struct(self, fields: Struct) -> bytearray:
        """Appends a structure; returns everything so far."""
        last = 0
        for number, (kind, value) in sorted(fields.items()):
            step = number - last
            written = (TRUE if value else FALSE) if kind in (TRUE, FALSE) else kind
            if 0 < step < 16:
                self.data.append(step << 4 | written)
            else:
                self.data.append(written)
                self._signed(number)
            if kind not in (TRUE, FALSE):
                self._value(kind, value)
            last = number
        self.data.append(0)
        return self.data

    def _value(self, kind: int, value: Any) -> None:
        if kind in (I16, I32, I64):
            self._signed(value)
        elif kind == BINARY:
            self._unsigned(len(value))
            self.data += value
        elif kind in (LIST, SET):
            of, entries = value
            self.data.append((min(len(entries), 15) << 4) | of)
            if len(entries) >= 15:
                self._unsigned(len(entries))
            for entry in entries:
                self._value(of, entry)
        elif kind == STRUCT:
            self.struct(value)
        elif kind == DOUBLE:
            self.data += value
        else:
            self.data.append(value)

    def _unsigned(self, value: int) -> None:
        while value > 127:
            self.data.append(value & 127 | 128)
            value >>= 7
        self.data.append(value)

    def _signed(self, value: int) -> None:
        self._unsigned((value << 1) ^ (value >> 63))
