"""`adamanip view`: draws an episode."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.cli.arguments import DatasetFolder, require_suffix


@dataclass
class ViewCommand:
    """Draws an episode or writes it for rerun: cloud, tool path, goals, tries, phases, effort and pictures, if any.

    rerun comes with lerobot[viz]. No display is needed.
    """

    root: DatasetFolder
    """Folder of a dataset."""

    out: Path
    """Output file: a picture (.png) of the whole episode, or a recording (.rrd) for `rerun FILE.rrd`."""

    episode: int = 0
    """Index of the episode."""

    def run(self) -> int:
        """Reads the episode and writes it. Returns 0."""
        kind = self.out.suffix.lower()
        require_suffix(self.out, (".png", ".rrd"), "--out episode.png")
        from lerobot_adamanip.datasets.view.episode import read_episode

        with contextlib.redirect_stdout(sys.stderr):
            episode = read_episode(self.root, self.episode, images=kind == ".rrd")
        print(episode.title)
        if kind == ".png":
            from lerobot_adamanip.datasets.view.picture import write_picture as write
        else:
            from lerobot_adamanip.datasets.view.viewer import save as write
        write(episode, self.out)
        print(f"written: {self.out}")
        return 0
