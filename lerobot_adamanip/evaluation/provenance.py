"""Provenance of a number: commit, versions, machine class. Contains no name of a machine, folder or user."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from lerobot_adamanip import __version__
from lerobot_adamanip.contract.versions import installed_versions
from lerobot_adamanip.evaluation.rates import LINE
from lerobot_adamanip.util import json_fields

HASH = json_fields.text(r"[0-9a-f]{8,64}", "a hash")
MACHINE = json_fields.table({"cores": json_fields.integer(1, 10**5), "gpu": json_fields.flag})
"""Check of the value of `machine_class`."""
VERSION_NUMBER = json_fields.integer(1, 10**6)
"""Check of a simulation or data version."""
_VERSION = json_fields.text(r"[0-9][0-9A-Za-z.+-]{0,30}", "a version")


@dataclass(frozen=True)
class Origin:
    """Software behind a number.

    Attributes:
        commit: commit of the repository; None outside one. ``changed``: whether tracked files differ from it.
        version: version of this package. ``versions``: `lerobot_adamanip.contract.versions.installed_versions`.
    """

    commit: Annotated[str | None, json_fields.optional(HASH)]
    changed: Annotated[bool, json_fields.flag]
    version: Annotated[str, _VERSION]
    versions: Annotated[Mapping[str, str], json_fields.mapping(LINE, LINE, 30)]


def present_origin() -> Origin:
    """Returns the origin of numbers that are measured now."""
    commit, changed = _commit()
    return Origin(commit, changed, __version__, dict(installed_versions()))


def machine_class() -> dict[str, int | bool]:
    """Returns the number of available cores and whether PyTorch has a GPU; nothing that identifies the machine."""
    import torch

    return {"cores": len(os.sched_getaffinity(0)), "gpu": torch.cuda.is_available()}


def machine_text(machine: Mapping[str, int | bool]) -> str:
    """Returns a machine class in words: ``2 cores, no GPU``."""
    cores = machine["cores"]
    return f"{cores} {'core' if cores == 1 else 'cores'}, {'a GPU' if machine['gpu'] else 'no GPU'}"


def _commit() -> tuple[str | None, bool]:
    """Returns the commit of this file's repository, and whether tracked files differ from it."""

    def git(*words: str) -> str | None:
        here = Path(__file__).parent
        try:
            done = subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, check=False, timeout=20)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    commit = git("rev-parse", "HEAD")
    if commit is None or git("ls-files", "--error-unmatch", Path(__file__).name) is None:
        return None, False  # installed, perhaps inside another repository
    return commit, bool(git("status", "--porcelain", "--untracked-files=no"))
