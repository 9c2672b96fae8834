"""`adamanip merge`: several datasets in one."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from lerobot_adamanip.demos.merge import merge


@dataclass
class Merge:
    """Writes one dataset with the episodes of several: demonstrations and corrections, or kinds of objects.

    LeRobot's own merging (lerobot-edit-dataset 0.6.1) cannot write clouds. The parts stay as they are.
    """

    roots: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of datasets with the same columns."""

    out: Path
    """Folder of the new dataset."""

    repo_id: str | None = None
    """Name of the new dataset. local/<folder name> by default."""

    def run(self) -> int:
        """Merges; 0 when the dataset is complete."""
        with contextlib.redirect_stdout(sys.stderr):
            episodes = merge(self.roots, self.out, repo_id=self.repo_id)
        print(f"{episodes} episodes in {self.out}")
        return 0
