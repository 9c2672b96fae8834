"""Provenance of a number: commit, versions, machine class. Contains no name of a machine, folder or user."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from lerobot_adamanip import __version__
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.fingerprint import versions

EQUIVALENT = Path(__file__).with_name("equivalent_fingerprints.json")
"""Table of code changes that change no result; extended by scripts/equivalent_fingerprint.py."""

HASH = json_fields.text(r"[0-9a-f]{8,64}", "a hash")
LINE = json_fields.text(r"[^\r\n|]{1,200}", "a line of at most 200 characters without |")
MACHINE = json_fields.table({"cores": json_fields.integer(1, 10**5), "gpu": json_fields.flag})
"""Check of the value of `machine_class`."""
_VERSION = json_fields.text(r"[0-9][0-9A-Za-z.+-]{0,30}", "a version")


@dataclass(frozen=True)
class Origin:
    """Code version behind a number.

    Attributes:
        commit: of the repository; None outside one. ``changed``: whether tracked files differ from it.
        version: of this package. ``versions``: of other packages that may affect results.
    """

    commit: Annotated[str | None, json_fields.optional(HASH)]
    changed: Annotated[bool, json_fields.flag]
    version: Annotated[str, _VERSION]
    versions: Annotated[Mapping[str, str], json_fields.mapping(LINE, LINE, 30)]


def present_origin() -> Origin:
    """Returns the origin of numbers that are measured now."""
    commit, changed = _commit()
    return Origin(commit, changed, __version__, dict(versions()))


def machine_class() -> dict[str, int | bool]:
    """Returns the number of available cores and whether PyTorch has a GPU; nothing that identifies the machine."""
    import torch

    return {"cores": len(os.sched_getaffinity(0)), "gpu": torch.cuda.is_available()}


def machine_text(machine: Mapping[str, int | bool]) -> str:
    """Returns a machine class in words: ``2 cores, no GPU``."""
    cores = machine["cores"]
    return f"{cores} {'core' if cores == 1 else 'cores'}, {'a GPU' if machine['gpu'] else 'no GPU'}"


def equivalent_fingerprints(present: Collection[str], table: Path = EQUIVALENT) -> frozenset[str]:
    """Returns the fingerprints, and all that ``table`` declares equivalent to them.

    Args:
        present: fingerprints of the present code.
        table: rows of ``old`` and ``new``; the command ``shown_by`` gave equal bytes with both.
    """
    rows = json.loads(table.read_text(encoding="utf-8"))
    found = set(present)
    while more := {row["old"] for row in rows if row["new"] in found} - found:
        found |= more
    return frozenset(found)


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
