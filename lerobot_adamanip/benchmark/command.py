"""Start and stop the commands of a benchmark as separate processes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from lerobot_adamanip.util.errors import ConfigurationError

type Runner = Callable[..., subprocess.Popen[bytes]]
"""Function that starts a command; takes the arguments of `begin_command`."""
_STOP_SECONDS = 20.0
_KEPT_BYTES = 2**34
_DEFAULTS = {
    # All inputs are local. For a method that has to download something, set HF_HUB_OFFLINE=0.
    "HF_HUB_OFFLINE": "1",
    "TOKENIZERS_PARALLELISM": "false",
    # By default glibc returns the pages of large tensors to the system, and every training step allocates them again.
    # Keeping them, in huge pages where possible, shortens a step of `dp3` from 0.80 s to 0.71 s (decision 79).
    "GLIBC_TUNABLES": (
        f"glibc.malloc.hugetlb=1:glibc.malloc.mmap_threshold={_KEPT_BYTES}:glibc.malloc.trim_threshold={_KEPT_BYTES}"
    ),
}
"""Default environment variables of the commands; the caller's environment overrides them."""


def begin_command(
    command: Sequence[str], *, folder: Path, log: Path, lock: int, threads: int = 0
) -> subprocess.Popen[bytes]:
    """Starts a program of this installation.

    Args:
        command: program and arguments.
        folder: working directory.
        log: file to append the output to.
        lock: inherited file descriptor of the folder's lock. No other benchmark can start in the folder while the
            command runs, even if this process is killed.
        threads: maximum number of compute threads; 0 for no limit.

    Raises:
        ConfigurationError: the program does not exist.
    """
    limit = {"OMP_NUM_THREADS": str(threads)} if threads else {}
    line = [find_program(command[0]), *command[1:]]
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
    """Ends a running command, by SIGTERM first, and waits for its exit."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(_STOP_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def find_program(name: str) -> str:
    """Returns the path of a program; prefers this Python's installation over PATH.

    Raises:
        ConfigurationError: the program does not exist.
    """
    beside = str(Path(sys.executable).parent)
    executable = shutil.which(name, path=os.pathsep.join((beside, os.environ.get("PATH", os.defpath))))
    if executable is None:
        raise ConfigurationError(
            "A program is missing.", got=name, allowed="a complete installation", hint="adamanip doctor"
        )
    return executable
