"""Counts which of our files and functions run in one use of the code: the length of a way."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = tuple(f"{ROOT / folder}/" for folder in ("lerobot_adamanip", "envs", "policies"))


@dataclass
class Way:
    """Functions that were called, as ``file:function``. A comprehension or lambda belongs to the function around it."""

    functions: set[str] = field(default_factory=set)

    @property
    def files(self) -> set[str]:
        """Files of these functions."""
        return {function.partition(":")[0] for function in self.functions}

    def __str__(self) -> str:
        return f"{len(self.files)} files, {len(self.functions)} functions:\n" + "\n".join(sorted(self.functions))


@contextmanager
def traced() -> Iterator[Way]:
    """Yields the `Way` through our packages that this thread takes in the block. Imports are not part of it."""
    way = Way()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        name = code.co_qualname.rpartition(".")[2]
        if event == "call" and code.co_filename.startswith(PACKAGES) and not name.startswith("<"):
            way.functions.add(f"{code.co_filename.removeprefix(f'{ROOT}/')}:{code.co_qualname}")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield way
    finally:
        sys.setprofile(before)
