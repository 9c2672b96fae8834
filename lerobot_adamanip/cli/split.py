"""`adamanip split`: splits a dataset into several."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.util.errors import ConfigurationError


@dataclass
class Split:
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
        text = "\n".join(f"{len(mine)} episodes in {self.out / name}" for name, mine in parts.items())
        print_result(self.json, {"out": self.out, "parts": {name: list(mine) for name, mine in parts.items()}}, text)
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
