"""`adamanip merge`: several datasets in one."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from lerobot_adamanip.cli.folder_argument import DatasetFolders
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.datasets.merge import Merged, merge


@dataclass
class Merge:
    """Writes one dataset with the episodes of several: demonstrations and corrections, or kinds of objects.

    Rows, pictures and the columns of episodes are kept as they are. The parts of one dataset come in its order, and
    all of them are that dataset again; others come one after another.
    """

    roots: DatasetFolders
    """Folders of datasets with the same columns."""

    out: Path
    """Folder of the new dataset."""

    repo_id: str | None = None
    """Name of the new dataset. local/<folder name> by default."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Merges; 0 when the dataset is complete."""
        # What libraries print must not get into the JSON.
        with show_progress({"merge": "episodes written"}) as progress, contextlib.redirect_stdout(sys.stderr):
            merged = merge(
                self.roots,
                self.out,
                repo_id=self.repo_id,
                progress=lambda done, total: progress("merge", done, total),
            )
        self._tell(merged)
        return 0

    def _tell(self, merged: Merged) -> None:
        if self.json:
            print(json.dumps({"out": str(self.out), **asdict(merged)}))
            return
        whole = ", all of the dataset that was parted" if merged.whole else ""
        print(f"{merged.episodes} episodes in {self.out}{whole}")
        if len(merged.fingerprints) > 1:
            print(
                f"Mind: they were recorded under {len(merged.fingerprints)} fingerprints, by code that differs; the "
                "column `fingerprint` of meta/episodes says which is which."
            )
