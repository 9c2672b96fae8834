"""Running the commands of a benchmark as processes of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from lerobot_adamanip.util.errors import ConfigurationError

_STOP_SECONDS = 20.0
_KEPT_BYTES = 2**34
_DEFAULTS = {
    # Nothing here is on the Hub. A method that has to download something is run with HF_HUB_OFFLINE=0.
    "HF_HUB_OFFLINE": "1",
    "TOKENIZERS_PARALLELISM": "false",
    # glibc gives each large tensor's pages back to the system, and a step of training asks for thousands of them anew.
    # Kept, and in huge pages where the system has them, a step of `dp3` takes 0.71 s instead of 0.80 (decision 79).
    "GLIBC_TUNABLES": (
        f"glibc.malloc.hugetlb=1:glibc.malloc.mmap_threshold={_KEPT_BYTES}:glibc.malloc.trim_threshold={_KEPT_BYTES}"
    ),
}
"""Environment of commands, where it does not say otherwise."""
_THREADS = "OMP_NUM_THREADS"


class Running(Protocol):
    """A command that was begun."""

    def poll(self) -> int | None:
        """Returns its exit status; None while it runs."""

    def stop(self) -> None:
        """Ends it, if it still runs, and waits for its end."""


class Runner(Protocol):
    """Begins commands."""

    def __call__(self, command: Sequence[str], *, folder: Path, log: Path, lock: int, threads: int) -> Running:
        """Begins a command.

        Args:
            command: program and arguments.
            folder: to run it in.
            log: file that what it says is appended to.
            lock: file descriptor that it inherits: while it runs, whatever becomes of this process, no other benchmark
                begins in the same folder.
            threads: that it may compute with; 0 for as many as it likes.
        """


@dataclass(frozen=True)
class _Process:
    process: subprocess.Popen[bytes]

    def poll(self) -> int | None:
        return self.process.poll()

    def stop(self) -> None:
        ended(self.process)


def ended(process: subprocess.Popen[bytes]) -> None:
    """Ends a process if it still runs: in order, if it does so soon."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(_STOP_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def begun(
    command: Sequence[str], *, folder: Path, log: Path, threads: int, pass_fds: Sequence[int] = ()
) -> subprocess.Popen[bytes]:
    """Returns the process of a program of this installation; arguments are those of `Runner`."""
    line = [find_program(command[0]), *command[1:]]
    with log.open("ab") as said:
        return subprocess.Popen(
            line,
            cwd=folder,
            env=environment(threads),
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            pass_fds=pass_fds,
        )


def environment(threads: int = 0) -> dict[str, str]:
    """Returns the environment of commands: this process's, and where that says nothing, what suits long work.

    Args:
        threads: of a command at most; 0 for no limit.
    """
    limit = {_THREADS: str(threads)} if threads else {}
    return {**_DEFAULTS, **limit, **os.environ}


def run_command(command: Sequence[str], *, folder: Path, log: Path, lock: int, threads: int = 0) -> Running:
    """Begins a program of this installation; see `Runner`."""
    return _Process(begun(command, folder=folder, log=log, threads=threads, pass_fds=(lock,)))


def find_program(name: str) -> str:
    """Returns the path of a program, of this Python's installation if it has one of that name.

    Raises:
        ConfigurationError: there is none.
    """
    beside = str(Path(sys.executable).parent)
    found = shutil.which(name, path=os.pathsep.join((beside, os.environ.get("PATH", os.defpath))))
    if found is None:
        raise ConfigurationError(
            "A program is missing.", got=name, allowed="a complete installation", hint="adamanip doctor"
        )
    return found
