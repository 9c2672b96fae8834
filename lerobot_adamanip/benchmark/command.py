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

from lerobot_adamanip.errors import ConfigurationError

_STOP_SECONDS = 20.0
_DEFAULTS = {"HF_HUB_OFFLINE": "1", "TOKENIZERS_PARALLELISM": "false"}
"""Nothing here is on the Hub. A method that has to download something is run with HF_HUB_OFFLINE=0."""
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


def command_environment(threads: int) -> dict[str, str]:
    """Returns the environment of a command that may compute with so many threads; 0 for as many as it likes."""
    limit = {_THREADS: str(threads)} if threads else {}
    return {**_DEFAULTS, **limit, **os.environ}


def run_command(command: Sequence[str], *, folder: Path, log: Path, lock: int, threads: int = 0) -> Running:
    """Begins a program of this installation; see `Runner`."""
    line = [find_program(command[0]), *command[1:]]
    with log.open("ab") as said:
        process = subprocess.Popen(
            line,
            cwd=folder,
            env=command_environment(threads),
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            pass_fds=(lock,),
        )
    return _Process(process)


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
