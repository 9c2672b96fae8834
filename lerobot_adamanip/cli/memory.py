"""`adamanip memory`: adds the memory of felt tries to a dataset."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.cli.progress import show_progress


@dataclass
class MemoryCommand:
    """Writes a copy of a dataset with a memory of felt tries, as `adamanip collect --memory` records it.

    A felt try is the commanded motion of a closed hand, and whether it was blocked, from poses and commands alone.
    Works on key frames, at control rate, and on recordings of the robot or its twin.
    """

    root: DatasetFolder
    """Folder of a dataset without a memory."""

    out: Path
    """Folder of the new dataset."""

    memory: Literal["events", "text"] = "events"
    """Form. events: numbers in observation.environment_state, for ACT and diffusion. text: a sentence after the
    instruction, for SmolVLA and pi0.5."""

    assets: Path | None = None
    """Folder of external assets, if the dataset was recorded with any."""

    repo_id: str | None = None
    """Name of the new dataset. Default: local/<folder name>."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Adds the memory. Returns 0 for a complete dataset."""
        from lerobot_adamanip.datasets.memory import add_memory

        with show_progress({"memory": "episodes written"}) as progress:
            advance = functools.partial(progress, "memory")
            episodes = add_memory(
                self.root, self.out, self.memory, assets=self.assets, repo_id=self.repo_id, progress=advance
            )
        values = {"out": self.out, "episodes": episodes, "memory": self.memory}
        print_result(self.json, values, f"{episodes} episodes with a memory in {self.out}")
        return 0
