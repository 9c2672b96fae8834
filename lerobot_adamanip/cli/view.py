"""`adamanip view`: draws an episode."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.cli.arguments import DatasetFolder, require_suffix


@dataclass
class ViewCommand:
    """Draws an episode: cloud, tool path, goals, tries, phases and effort. No display is needed."""

    root: DatasetFolder
    """Folder of a dataset."""

    out: Path
    """Output file: a picture (.png) of the whole episode."""

    episode: int = 0
    """Index of the episode."""

    def run(self) -> int:
        """Reads the episode and draws it. Returns 0."""
        require_suffix(self.out, (".png",), "--out episode.png")
        from lerobot_adamanip.datasets.view import read_episode, write_picture

        episode = read_episode(self.root, self.episode)
        print(episode.title)
        write_picture(episode, self.out)
        print(f"written: {self.out}")
        return 0
