"""`adamanip merge`: merges several datasets into one."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from pathlib import Path

from lerobot_adamanip.cli.arguments import DatasetFolders, print_result
from lerobot_adamanip.cli.progress import show_progress


@dataclass
class Merge:
    """Writes one dataset with the episodes of several, e.g. demonstrations and corrections, or several categories.

    Rows, pictures and episode columns stay unchanged. Parts of a split dataset return to their original order, and all
    parts give the same dataset again. Other datasets follow one after another.
    """

    roots: DatasetFolders
    """Folders of datasets with the same columns."""

    out: Path
    """Folder of the new dataset."""

    repo_id: str | None = None
    """Name of the new dataset. Default: local/<folder name>."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Merges datasets. Returns 0 for a complete dataset."""
        from lerobot_adamanip.datasets.editing import merge

        with show_progress({"merge": "episodes written"}) as progress:
            merged = merge(self.roots, self.out, repo_id=self.repo_id, progress=functools.partial(progress, "merge"))
        text = f"{merged.episodes} episodes in {self.out}"
        if merged.whole:
            text += ", all of the dataset that was split"
        if merged.mixed_versions:
            text += f"\nNote: recorded with different versions (column `versions`): {merged.mixed_versions}."
        print_result(self.json, {"out": self.out, **asdict(merged)}, text)
        return 0
