"""`adamanip filter`: a dataset of the episodes that fulfil conditions."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import tyro

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.cli.progress import show_progress


@dataclass
class Filter:
    """Writes a dataset with the episodes of another one that fulfil every condition.

    A condition compares a column of the episodes: failed_tries>=1, recoveries>0, success=true, late=false,
    key_frames<=30, hidden.locked=true, category=safe, object_split=seen, object_id=safe_000,safe_003,
    episode_index=0:100 (100 left out). An unknown name lists the known ones. Rows, pictures and the columns of
    episodes are kept as they are.
    """

    root: DatasetFolder
    """Folder of a dataset."""

    where: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """A condition: a column, one of = != < <= > >=, and a value. Give it again for one more; all have to hold."""

    out: Path | None = None
    """Folder of the new dataset. Without it nothing is written: the episodes are counted."""

    repo_id: str | None = None
    """Name of the new dataset. local/<folder name> by default."""

    json: bool = False
    """Print one JSON object instead of text, with the indices of the episodes."""

    def run(self) -> int:
        """Chooses and writes; 0 when the dataset is complete."""
        from lerobot_adamanip.datasets.filter import filter_episodes

        with show_progress({"filter": "episodes written"}) as progress:
            advance = functools.partial(progress, "filter")
            chosen = filter_episodes(self.root, self.where, self.out, repo_id=self.repo_id, progress=advance)
        counted = f"{len(chosen)} episodes fulfil the conditions; --out FOLDER writes them"
        text = counted if self.out is None else f"{len(chosen)} episodes in {self.out}"
        print_result(self.json, {"out": self.out, "episodes": len(chosen), "chosen": chosen}, text)
        return 0
