"""Output folders: resolve, lock and probe the target before work starts; keep unfinished output in a work folder.

The work folder is beside the target; its suffix belongs to one command. No command removes another one's output.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError

INFO = "meta/info.json"
"""A file of every LeRobotDataset."""
COLLECTING, RENDERING, WRITING, CONVERTING = ".partial", ".rendering", ".writing", ".converting"
"""Suffixes of the work folders of collect; render; filter, split and merge; keyframes."""
RECORDING = ".recording"
"""Suffix of the work folder of `lerobot_env_adamanip.dataset_recorder.DatasetRecorder`."""
WORK_FOLDERS = {
    COLLECTING: ("episodes", "attempts", "failed", "collection.json", "dataset", "dataset-failed"),
    RENDERING: ("episodes", "collection.json", "source", "dataset"),
    WRITING: ("dataset",),
    CONVERTING: ("episodes", "dataset", "merged"),
    RECORDING: ("episodes", "recording.json", "dataset"),
}
"""Suffix -> allowed names in such a folder."""
_RESUMED = {COLLECTING: "adamanip collect", RENDERING: "adamanip render", RECORDING: "program with DatasetRecorder"}
"""Suffix -> command that can resume from the episodes there."""
_EPISODE_FOLDERS = ("episodes", "failed")
_PROBE = "probe"
MIN_FREE_BYTES = 20_000_000
"""Free space that is needed in addition to the data."""


@dataclass(frozen=True)
class OutputFolder:
    """A locked output folder: resolved ``root`` of the finished dataset, and ``suffix`` of the work folder."""

    root: Path
    suffix: str

    @property
    def work(self) -> Path:
        """Folder beside ``root`` for unfinished output."""
        return self.root.with_name(self.root.name + self.suffix)

    def fresh(self, name: str) -> Path:
        """Returns a free path in the work folder, after removing leftovers of an interrupted run."""
        files.remove_tree(self.work / name)
        return self.work / name

    def require_free(self) -> None:
        """Raises `DatasetError` if ``root`` exists, or another command has unfinished episodes for it."""
        if not is_free(self.root):
            raise DatasetError(
                "There is something at the root of the new dataset.",
                got=self.root,
                allowed="a folder that does not exist, or is empty",
                hint="another folder",
            )
        for suffix, command in _RESUMED.items():
            folder = self.root.with_name(self.root.name + suffix)
            if suffix != self.suffix and (episodes := count_episodes(folder)):
                raise DatasetError(
                    f"An unfinished `{command}` waits for this output folder.",
                    got=f"{episodes} episodes in {folder}",
                    allowed="one command for an output folder",
                    hint=f"finish that `{command}` first; or another folder",
                )

    def require_room(self, data_bytes: int = 0) -> None:
        """Raises `DatasetError` if the disk has too little free space for the data."""
        free, needed = shutil.disk_usage(self.work).free, data_bytes + MIN_FREE_BYTES
        if free < needed:
            raise DatasetError(
                "There is not enough room on the disk.",
                got=f"{free / 1e6:.0f} MB free at {self.root.parent}",
                allowed=f"{needed / 1e6:.0f} MB or more",
                hint="a folder on another disk",
            )

    def publish(self, built: Path) -> None:
        """Moves a finished dataset to ``root`` and removes the work folder."""
        files.move_durably(built, self.root)
        files.crash_point("dataset in place")
        self.discard()

    def discard(self) -> None:
        """Removes the work folder; its episodes are published or can be recorded again."""
        for name in WORK_FOLDERS[self.suffix]:
            path = self.work / name
            if path.is_dir():
                files.remove_tree(path)
                files.crash_point("shards partly removed")
        files.remove_tree(self.work)
        files.crash_point("cleaned")


@contextlib.contextmanager
def owned_output(target: str | Path, suffix: str) -> Iterator[OutputFolder]:
    """Locks an output folder, creates its work folder, and tests that the finished dataset can be moved into place.

    Raises:
        DatasetError: the folder is not writable or lies in a dataset, another command uses it, or the work folder has
            foreign files.
    """
    output = OutputFolder(resolve_output(target), suffix)
    _require_outside_datasets(output.root)
    missing = [folder for folder in output.root.parents if not folder.exists()]
    with contextlib.ExitStack() as stack:
        stack.callback(_remove_empty, missing)
        with _clear_errors(output.root):
            output.root.parent.mkdir(parents=True, exist_ok=True)
        stack.enter_context(lock_output(output.root))
        with _clear_errors(output.root):
            _require_ours(output.work, WORK_FOLDERS[suffix])
            output.work.mkdir(exist_ok=True)
            stack.callback(_remove_empty, [output.work])
            _probe(output)
        files.crash_point("output claimed")
        yield output


def _require_outside_datasets(root: Path) -> None:
    if dataset := next((folder for folder in root.parents if (folder / INFO).is_file()), None):
        raise DatasetError(
            "The output folder lies in a dataset.",
            got=f"{root} in {dataset}",
            allowed="a folder that is in no dataset: LeRobot reads every file in its own",
            hint=f"a folder beside it, such as {dataset.with_name(root.name)}",
        )


def _remove_empty(folders: Iterable[Path]) -> None:
    """Removes empty folders, innermost first, and stops at the first that is not empty."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()


def resolve_output(target: str | Path) -> Path:
    """Returns the resolved folder of a path, without links and ``..``; raises `DatasetError`."""
    try:
        root = Path(target).expanduser().resolve()
        root.exists()  # raises OSError for a name that is too long, and a folder that may not be looked into
    except (OSError, RuntimeError) as error:
        raise _unwritable(target, error) from error
    if not root.name:
        raise _unwritable(target, "it is the root of the file system")
    return root


def is_free(root: Path) -> bool:
    """Returns whether a path does not exist or is an empty folder."""
    return not root.exists() or (root.is_dir() and not any(root.iterdir()))


def count_episodes(work: Path) -> int:
    """Returns the number of recorded episodes in a work folder."""
    return sum(len(list((work / name).glob("*.safetensors"))) for name in _EPISODE_FOLDERS)


def lock_path(root: Path) -> Path:
    """Returns the lock file of an output folder; ``.<name>.lock`` is LeRobot's."""
    return root.with_name(f".{root.name}.adamanip-lock")


@contextlib.contextmanager
def lock_output(root: Path, *, optional: bool = False) -> Iterator[None]:
    """Locks a resolved output folder against this project's other commands. A dead process's lock is released.

    An ``optional`` lock is skipped if no file can be written beside the folder.

    Raises:
        DatasetError: another process has the lock.
    """
    path, descriptor = lock_path(root), None
    try:
        descriptor = _locked(path)
        _close_locks_in_forks()
        _held.add(descriptor)
    except BlockingIOError as error:
        raise DatasetError(
            "Another command is at work in this folder.",
            got=root,
            allowed="one at a time",
            hint="wait for its end, or another folder",
        ) from error
    except OSError as error:
        if not optional:
            raise _unwritable(root, error) from error
    try:
        yield
    finally:
        if descriptor in _held:
            path.unlink(missing_ok=True)
            _held.discard(descriptor)
            os.close(descriptor)


def _locked(path: Path) -> int:
    """Returns the descriptor of a locked file, and makes sure that its last owner has not removed it."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.exists() and os.path.samestat(os.stat(path), os.fstat(descriptor)):
                return descriptor
        except FileNotFoundError:
            pass
        except OSError:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _close_locks() -> None:
    """Closes inherited locks in a forked process, for example LeRobot's encoder, which may outlive its parent."""
    while _held:
        os.close(_held.pop())


@functools.cache
def _close_locks_in_forks() -> None:
    os.register_at_fork(after_in_child=_close_locks)


_held: set[int] = set()


def _require_ours(work: Path, names: tuple[str, ...]) -> None:
    if work.is_symlink() or (work.exists() and not work.is_dir()):
        foreign = [work.name]
    else:
        entries = sorted(path.name for path in work.glob("*"))
        foreign = [name for name in entries if name not in (*names, _PROBE) and not re.fullmatch(r"\..*\.tmp", name)]
    if foreign:
        raise DatasetError(
            "There is something else in the folder for unfinished output.",
            got=f"{work}: {', '.join(foreign[:3])}",
            allowed="a folder that does not exist, or that this command has made",
            hint="move it away, or another folder",
        )


def _probe(output: OutputFolder) -> None:
    """Raises `OSError` if a work folder cannot be moved to ``root`` later: mount point, other file system."""
    probe = output.work / _PROBE
    moved = output.root if output.root.is_dir() else output.root.with_name(f".{output.root.name}.{_PROBE}")
    if is_free(moved):
        probe.mkdir(exist_ok=True)
        os.replace(probe, moved)
    if moved != output.root:
        moved.rmdir()


@contextlib.contextmanager
def _clear_errors(root: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _unwritable(root, error) from error


def _unwritable(root: str | Path, error: object) -> DatasetError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else error
    return DatasetError(
        "A dataset cannot be written there.",
        got=f"{root}: {reason}",
        allowed="a folder that can be made and renamed, no mount point",
        hint="another folder",
    )
