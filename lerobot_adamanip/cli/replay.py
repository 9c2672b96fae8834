"""`adamanip replay`: replay a recorded episode in the simulator and compare."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.cli.folder_argument import DatasetFolder
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.collection.replay import ReplayResult, replay


@dataclass
class Replay:
    """Replays a recorded episode in the simulator, from its stored seed and actions, and compares what is seen.

    Exit status 0 if the replay matches the recording, 1 if not. Says which part of the code has changed since.
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
    """Largest difference allowed in any column, in its own units (m, rad, rad/s, N m)."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Replays and compares; 0 if everything agrees."""
        result = self._replay()
        agrees = result.agrees(self.tolerance)
        if self.json:
            print(json.dumps({**dataclasses.asdict(result), "agrees": agrees}))
            return 0 if agrees else 1
        print(f"episode {result.episode}: {result.object_id}, seed {result.seed}")
        print(f"  key frames  {result.replayed} replayed, {result.key_frames} recorded")
        print(f"  success     {result.success} replayed, {result.recorded_success} recorded")
        for name, value in result.differences.items():
            print(f"  {name:<24} largest difference {value:.3g}")
        if result.changed:
            print(f"Recorded under another fingerprint: {', '.join(result.changed)} differ.")
        print("Replay matches the recording." if agrees else f"Replay differs (tolerance {self.tolerance:g}).")
        return 0 if agrees else 1

    def _replay(self) -> ReplayResult:
        from lerobot_env_adamanip.make_env import make_keyframe_env

        # What libraries print must not get into the JSON.
        with show_progress({"replay": "key frames"}) as progress, contextlib.redirect_stdout(sys.stderr):
            return replay(
                self.root,
                self.episode,
                make_keyframe_env,
                assets=self.assets,
                video=self.out,
                progress=lambda done, total: progress("replay", done, total),
            )
