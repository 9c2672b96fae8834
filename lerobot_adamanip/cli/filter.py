"""`adamanip filter`: writes a dataset of the episodes that fulfil conditions."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import tyro

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.cli.progress import show_progress


@dataclass
class Filter:
    """Writes a dataset with the episodes of another dataset that fulfil all conditions.

    A condition compares an episode column: failed_tries>=1, recoveries>0, success=true, late=false, key_frames<=30,
    hidden.locked=true, category=safe, object_split=seen, object_id=safe_000,safe_003, episode_index=0:100 (100 is
    excluded). An error for an unknown name lists the known ones. Rows, pictures and episode columns stay unchanged.
    """

    root: DatasetFolder
    """Folder of a dataset."""

    where: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Condition: a column, one of = != < <= > >=, and a value. Repeat the option for more; all must hold."""

    out: Path | None = None
    """Folder of the new dataset. Default: only count the episodes."""

    repo_id: str | None = None
    """Name of the new dataset. Default: local/<folder name>."""

    json: bool = False
    """Print one JSON object instead of text, with the indices of the episodes."""

    def run(self) -> int:
        """Selects and writes episodes. Returns 0 for a complete dataset."""
        from lerobot_adamanip.datasets.editing import filter_episodes

        with show_progress({"filter": "episodes written"}) as progress:
            advance = functools.partial(progress, "filter")
            chosen = filter_episodes(self.root, self.where, self.out, repo_id=self.repo_id, progress=advance)
        counted = f"{len(chosen)} episodes fulfil the conditions; --out FOLDER writes them"
        text = counted if self.out is None else f"{len(chosen)} episodes in {self.out}"
        print_result(self.json, {"out": self.out, "episodes": len(chosen), "chosen": chosen}, text)
        return 0
