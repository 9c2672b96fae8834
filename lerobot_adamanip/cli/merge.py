"""`adamanip merge`: several datasets in one."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from pathlib import Path

from lerobot_adamanip.cli.arguments import DatasetFolders, print_result
from lerobot_adamanip.cli.progress import show_progress


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
        from lerobot_adamanip.datasets.merge import merge

        with show_progress({"merge": "episodes written"}) as progress:
            merged = merge(self.roots, self.out, repo_id=self.repo_id, progress=functools.partial(progress, "merge"))
        text = f"{merged.episodes} episodes in {self.out}"
        if merged.whole:
            text += ", all of the dataset that was split"
        if len(merged.fingerprints) > 1:
            text += (
                f"\nMind: {len(merged.fingerprints)} versions of the code recorded them (column `fingerprint` of "
                "meta/episodes)."
            )
        print_result(self.json, {"out": self.out, **asdict(merged)}, text)
        return 0
