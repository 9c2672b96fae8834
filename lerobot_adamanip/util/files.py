"""Crash-safe files: atomic writes, synced files and folders, durable moves."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import uuid
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from lerobot_adamanip.util.errors import AdaManipError, DatasetError

CRASH_POINTS = (
    "output claimed", "collection prepared", "shard written", "shard in place", "all recorded", "assembly begun",
    "episode assembled", "dataset written", "dataset described", "dataset synced", "dataset verified",
    "dataset renamed", "dataset in place", "shards partly removed", "cleaned",
)  # fmt: skip
"""Points of a collection at which a test may end the process."""
REPAIR_POINTS = ("moved aside", "partly mended")
"""Points of a repair at which a test may end the process."""
on_crash_point: Callable[[str], None] | None = None
"""Callback for every crash point; set by tests only."""


def crash_point(name: str) -> None:
    """Marks a point at which a crash must lose no data; tests use it, see `on_crash_point`."""
    assert name in CRASH_POINTS + REPAIR_POINTS
    if on_crash_point is not None:
        on_crash_point(name)


def write_atomically(path: Path, content: bytes, *, crash_points: tuple[str, str] | None = None) -> None:
    """Writes a file so that after a crash it has either the new content or the old one.

    Args:
        path: file path; the folder must exist.
        content: new content.
        crash_points: names of the points before and after the rename.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")  # threads may write the same file
    try:
        with open(temporary, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if crash_points is not None:
            crash_point(crash_points[0])
        os.replace(temporary, path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):  # a failed write names no file
            error.filename = str(path)
        raise
    sync(path.parent)
    if crash_points is not None:
        crash_point(crash_points[1])


def full_disk_error(error: Exception, places: Iterable[str] = ()) -> AdaManipError | None:
    """Returns the error for a write to a full disk; None for any other error.

    Args:
        error: error of the write.
        places: paths that may have been written to. If ``error`` names no file, the error names the one of them, or of
            the temporary files, with the least free space.
    """
    if not isinstance(error, OSError) or error.errno not in (errno.ENOSPC, errno.EDQUOT):
        return None
    paths = [Path(each) for each in ([error.filename] if error.filename else (*places, os.getenv("TMPDIR", "/tmp")))]
    existing = [next(each for each in (path, *path.parents) if os.path.exists(each)) for path in paths]
    free, path = min(zip([shutil.disk_usage(each).free for each in existing], paths, strict=True))
    return AdaManipError(
        "No space is left on the disk.",
        got=f"{path}: {free / 1e6:.1f} MB free",
        allowed="free space for all files that the command writes",
        hint="free some space there, then repeat the command",
    )


def append_line(path: Path, line: str) -> None:
    """Appends a line; creates the folder if needed. Several processes can share a log.

    If an earlier write was cut off, the line starts after it, so that a cut line damages no other one.

    Raises:
        OSError: the line was not written completely, for instance because the disk is full.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a+b", buffering=0) as file:
        with contextlib.suppress(OSError):  # some network file systems have no locks
            fcntl.flock(file, fcntl.LOCK_EX)
        end = file.seek(0, os.SEEK_END)
        is_cut = end > 0 and os.pread(file.fileno(), 1, end - 1) != b"\n"
        rest = memoryview(b"\n" * is_cut + f"{line}\n".encode())
        while rest:
            rest = rest[file.write(rest) :]


def last_line(path: Path) -> str:
    """Returns the last non-empty line of a log; "" if its last 4096 bytes have none."""
    try:
        with open(path, "rb") as file:
            file.seek(max(0, path.stat().st_size - 4096))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


@contextlib.contextmanager
def locked(folder: Path, busy: str, hint: str) -> Iterator[int]:
    """Locks a folder against other processes; raises `DatasetError` with the text ``busy`` if it is locked.

    Yields the lock's file descriptor; a process that inherits it holds the lock even if this process ends.
    """
    with open(folder / "lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise DatasetError(busy, got=folder, allowed="one at a time", hint=hint) from error
        yield lock.fileno()


def sync(path: Path) -> None:
    """Makes a file's content, or a folder's list of names, durable."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Makes a folder and its content durable: files first, then the folders from the inside out."""
    for parent, _, names in os.walk(folder, topdown=False):
        for name in names:
            sync(Path(parent) / name)
        sync(Path(parent))


def move_durably(source: Path, target: Path) -> None:
    """Renames a synced file or folder to ``target``, which may be a file, an empty folder or missing."""
    os.replace(source, target)
    crash_point("dataset renamed")
    sync(target.parent)
    if source.parent != target.parent:
        sync(source.parent)


def remove_tree(folder: Path) -> None:
    """Removes a folder, if it exists, durably."""
    if folder.exists():
        shutil.rmtree(folder)
        sync(folder.parent)


def remove_temporaries(folder: Path) -> None:
    """Removes temporary files that a crashed `write_atomically` left in a folder."""
    for path in folder.glob(".*.tmp"):
        path.unlink(missing_ok=True)


def tree_bytes(folder: Path) -> int:
    """Returns the total size of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
