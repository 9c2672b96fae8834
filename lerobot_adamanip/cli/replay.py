"""`adamanip replay`: replays a recorded episode in the simulator and compares it."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result, require_suffix
from lerobot_adamanip.cli.progress import show_progress

if TYPE_CHECKING:
    from lerobot_adamanip.collection.replay import ReplayResult


@dataclass
class ReplayCommand:
    """Replays a recorded episode from its stored seed and actions, and compares the observations.

    Exit status 0 if the replay matches the recording, 1 if not. Lists the parts of the code that have changed since.
    """

    root: DatasetFolder
    """Folder of a dataset that `adamanip collect` wrote."""

    episode: int = 0
    """Index of the episode."""

    assets: Path | None = None
    """Folder of external assets, if the dataset was recorded with any."""

    out: Path | None = None
    """Write a video (.mp4): the recording on the left, the replay on the right."""

    tolerance: float = 1e-4
    """Maximum difference in any column, in the column's unit (m, rad, rad/s, N m)."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Replays and compares. Returns 0 if everything agrees."""
        if self.out is not None:
            require_suffix(self.out, (".mp4",), "replay.mp4")
        from lerobot_adamanip.collection.replay import replay
        from lerobot_env_adamanip.make_environment import make_environment

        with show_progress({"replay": "replayed"}) as progress:
            advance = functools.partial(progress, "replay")
            result = replay(
                self.root, self.episode, make_environment, assets=self.assets, video=self.out, progress=advance
            )
        agrees = result.agrees(self.tolerance)
        print_result(self.json, {**dataclasses.asdict(result), "agrees": agrees}, self._text(result, agrees))
        return 0 if agrees else 1

    def _text(self, result: ReplayResult, agrees: bool) -> str:
        lines = [
            f"episode {result.episode}: {result.object_id}, seed {result.seed}",
            f"  {result.unit:<10}  {result.replayed} replayed, {result.key_frames} recorded",
            f"  success     {result.success} replayed, {result.recorded_success} recorded",
            *(f"  {name:<24} largest difference {value:.3g}" for name, value in result.differences.items()),
        ]
        if result.changed:
            lines.append(f"Recorded with other versions: {', '.join(result.changed)} differ.")
        verdict = "Replay matches the recording." if agrees else f"Replay differs (tolerance {self.tolerance:g})."
        return "\n".join([*lines, verdict])
