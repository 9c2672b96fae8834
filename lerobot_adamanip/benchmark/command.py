"""Running the commands of a benchmark as processes of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from lerobot_adamanip.util.errors import ConfigurationError

type Runner = Callable[..., subprocess.Popen[bytes]]
"""Begins a command; arguments are those of `begin_command`."""
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


def begin_command(
    command: Sequence[str], *, folder: Path, log: Path, lock: int, threads: int = 0
) -> subprocess.Popen[bytes]:
    """Begins a program of this installation.

    Args:
        command: program and arguments.
        folder: to run it in.
        log: file that its output is appended to.
        lock: file descriptor that it inherits: while it runs, even if this process is killed, no other benchmark begins
            in the same folder.
        threads: that it may compute with; 0 for as many as it likes.

    Raises:
        ConfigurationError: there is no such program.
    """
    limit = {"OMP_NUM_THREADS": str(threads)} if threads else {}
    line = [_find_program(command[0]), *command[1:]]
    with log.open("ab") as output:
        return subprocess.Popen(
            line,
            cwd=folder,
            env={**_DEFAULTS, **limit, **os.environ},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            pass_fds=(lock,),
        )


def end_command(process: subprocess.Popen[bytes]) -> None:
    """Ends a command if it still runs, by SIGTERM first, and waits for its end."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(_STOP_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _find_program(name: str) -> str:
    """Returns the path of a program, of this Python's installation if it has one of that name."""
    beside = str(Path(sys.executable).parent)
    found = shutil.which(name, path=os.pathsep.join((beside, os.environ.get("PATH", os.defpath))))
    if found is None:
        raise ConfigurationError(
            "A program is missing.", got=name, allowed="a complete installation", hint="adamanip doctor"
        )
    return found
