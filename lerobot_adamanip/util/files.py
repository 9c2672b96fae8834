"""Files that survive a power cut: atomic writes, syncs of files and folders, durable moves."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from lerobot_adamanip.util.errors import DatasetError

CRASH_POINTS = (
    "output claimed", "collection prepared", "shard written", "shard in place", "all recorded", "assembly begun",
    "episode assembled", "dataset written", "dataset described", "dataset synced", "dataset verified",
    "dataset renamed", "dataset in place", "shards partly removed", "cleaned",
)  # fmt: skip
"""Points of a collection at which a test may end the process."""
REPAIR_POINTS = ("moved aside", "partly mended")
"""Points of a repair."""
on_crash_point: Callable[[str], None] | None = None
"""Called at every crash point; set by tests alone."""


def crash_point(name: str) -> None:
    """Marks a point at which a crash must lose nothing; for tests, see `on_crash_point`."""
    assert name in CRASH_POINTS + REPAIR_POINTS
    if on_crash_point is not None:
        on_crash_point(name)


def write_atomically(path: Path, content: bytes, *, crash_points: tuple[str, str] | None = None) -> None:
    """Writes a file that is complete after a crash, or as it was before.

    Args:
        path: of the file; its folder exists.
        content: of the file.
        crash_points: before and after the rename.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if crash_points is not None:
            crash_point(crash_points[0])
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)
    if crash_points is not None:
        crash_point(crash_points[1])


def append_line(path: Path, line: str) -> None:
    """Appends a line; the folder is made if it is missing.

    One write to a file opened for appending is atomic, so processes may share a log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(descriptor, f"{line}\n".encode())
    finally:
        os.close(descriptor)


def last_line(path: Path, within: int = 4096) -> str:
    """Returns the last line of a log that is not empty; "" where there is none in its last ``within`` bytes."""
    try:
        with open(path, "rb") as file:
            file.seek(max(0, path.stat().st_size - within))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


@contextlib.contextmanager
def locked(folder: Path, busy: str, hint: str) -> Iterator[int]:
    """Keeps other processes out of a folder; raises `DatasetError` that says ``busy`` if one is in it.

    Yields the lock's file descriptor: a process that inherits it keeps others out, too, whatever becomes of this one.
    """
    with open(folder / "lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise DatasetError(busy, got=folder, allowed="one at a time", hint=hint) from error
        yield lock.fileno()


def sync(path: Path) -> None:
    """Makes a file's content, or the names in a folder, durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Makes a folder with everything in it durable: files first, then the folders that name them, inner ones first."""
    for parent, _, names in os.walk(folder, topdown=False):
        for name in names:
            sync(Path(parent) / name)
        sync(Path(parent))


def move_durably(source: Path, target: Path) -> None:
    """Renames a synced file or folder to ``target``, whose old content, if any, has to be an empty folder or a file."""
    os.replace(source, target)
    crash_point("dataset renamed")
    sync(target.parent)
    if source.parent != target.parent:
        sync(source.parent)


def remove_tree(folder: Path) -> None:
    """Removes a folder, if it is there, and makes that durable."""
    if folder.exists():
        shutil.rmtree(folder)
        sync(folder.parent)


def remove_temporaries(folder: Path) -> None:
    """Removes what a process that died in `write_atomically` left in a folder."""
    for path in folder.glob(".*.tmp"):
        path.unlink(missing_ok=True)


def tree_bytes(folder: Path) -> int:
    """Returns the size of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
