"""Running the commands of a benchmark as processes of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from lerobot_adamanip.errors import ConfigurationError

_STOP_SECONDS = 20.0
_DEFAULTS = {"HF_HUB_OFFLINE": "1", "TOKENIZERS_PARALLELISM": "false"}
"""Nothing here is on the Hub. A method that has to download something is run with HF_HUB_OFFLINE=0."""


class Runner(Protocol):
    """Runs a command and waits for its end."""

    def __call__(self, command: Sequence[str], *, folder: Path, log: Path, lock: int) -> int:
        """Returns a command's exit status.

        Args:
            command: program and arguments.
            folder: to run it in.
            log: file that what it says is appended to.
            lock: file descriptor that it inherits: while it runs, whatever becomes of this process, no other benchmark
                begins in the same folder.
        """


def run_command(command: Sequence[str], *, folder: Path, log: Path, lock: int) -> int:
    """Runs a program of this installation; see `Runner`. Ends it if this process is interrupted."""
    line = [find_program(command[0]), *command[1:]]
    environment = {**_DEFAULTS, **os.environ}
    with log.open("ab") as said:
        process = subprocess.Popen(
            line, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=said, stderr=said, pass_fds=(lock,)
        )
        try:
            return process.wait()
        finally:
            _end(process)


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


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(_STOP_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
