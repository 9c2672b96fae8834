"""`adamanip split`: a dataset as several."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.util.errors import ConfigurationError


@dataclass
class Split:
    """Writes every episode of a dataset into one of several, so that `adamanip merge` of them is the dataset again.

    With --by object_id no object is in two parts; with --by and no --parts each value gets a part of its own. Columns
    are those of `adamanip filter`. The seed alone decides the parts.
    """

    root: DatasetFolder
    """Folder of a dataset."""

    out: Path
    """Folder of the new datasets, one folder for each part in it."""

    parts: str | None = None
    """Names and shares, like train=0.8,validation=0.2; the shares make 1."""

    by: str = "episode_index"
    """Column whose values stay together."""

    seed: int = 0
    """Of the random draw."""

    json: bool = False
    """Print one JSON object instead of text, with the indices of the episodes of each part."""

    def run(self) -> int:
        """Parts and writes; 0 when all datasets are complete."""
        shares = self._shares()
        from lerobot_adamanip.datasets.split import split_episodes

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
            allowed="different names (letters, digits, _ and -) with shares; or --by alone, for a part for each value",
            hint="--parts train=0.8,validation=0.2",
        )
