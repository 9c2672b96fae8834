"""`adamanip merge`, `filter` and `split`: write datasets with the episodes of others."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from lerobot_adamanip.cli.arguments import DatasetFolder, DatasetFolders, print_result
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.util.errors import ConfigurationError


@dataclass
class MergeCommand:
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


@dataclass
class FilterCommand:
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


@dataclass
class SplitCommand:
    """Splits the episodes of a dataset into several datasets. `adamanip merge` of all parts restores the dataset.

    With --by object_id, no object is in two parts. With --by and without --parts, each value gets its own part. Columns
    are those of `adamanip filter`. The parts depend only on the seed.
    """

    root: DatasetFolder
    """Folder of a dataset."""

    out: Path
    """Parent folder of the new datasets, with one folder per part."""

    parts: str | None = None
    """Names and shares of the parts, e.g. train=0.8,validation=0.2. The shares sum to 1."""

    by: str = "episode_index"
    """Column whose equal values stay in one part, e.g. object_id."""

    seed: int = 0
    """Seed of the random split."""

    json: bool = False
    """Print one JSON object instead of text, with the indices of the episodes of each part."""

    def run(self) -> int:
        """Splits and writes. Returns 0 when all datasets are complete."""
        shares = self._shares()
        from lerobot_adamanip.datasets.editing import split_episodes

        with show_progress({"split": "episodes written"}) as progress:
            advance = functools.partial(progress, "split")
            parts = split_episodes(self.root, self.out, shares, by=self.by, seed=self.seed, progress=advance)
        text = "\n".join(f"{len(indices)} episodes in {self.out / name}" for name, indices in parts.items())
        values = {"out": self.out, "parts": {name: list(indices) for name, indices in parts.items()}}
        print_result(self.json, values, text)
        return 0

    def _shares(self) -> dict[str, float] | None:
        if self.parts is None:
            if self.by == "episode_index":
                raise self._wrong("neither --parts nor --by")
            return None
        shares: dict[str, float] = {}
        for part in self.parts.split(","):
            name, _, share = (word.strip() for word in part.partition("="))
            try:
                known, shares[name] = name in shares, float(share)
            except ValueError:
                raise self._wrong(self.parts) from None
            if known or not name.replace("_", "").replace("-", "").isalnum():
                raise self._wrong(self.parts)
        return shares

    @staticmethod
    def _wrong(got: str) -> ConfigurationError:
        return ConfigurationError(
            "Wrong parts.",
            got=got,
            allowed="different names (letters, digits, _ and -) with shares; or only --by, for one part per value",
            hint="--parts train=0.8,validation=0.2",
        )
