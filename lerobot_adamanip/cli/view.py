"""`adamanip view`: look at an episode."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.cli.arguments import DatasetFolder
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from lerobot_adamanip.datasets.view.episode import ViewedEpisode

_KINDS = (".png", ".rrd")


@dataclass
class View:
    """Shows an episode in rerun: cloud, tool path, goals, tries, phases, effort, pictures if there are any.

    Opens rerun's viewer, unless --out is given. The viewer comes with lerobot[viz]. On a machine without a display, use
    --out.
    """

    root: DatasetFolder
    """Folder of a dataset."""

    episode: int = 0
    """Index of the episode."""

    out: Path | None = None
    """Write a picture (.png) of the whole episode, or a recording (.rrd) that `rerun FILE.rrd` shows. Neither needs a
    display, and a picture needs no rerun."""

    def run(self) -> int:
        """Reads the episode and shows or writes it; 0."""
        kind = None if self.out is None else self.out.suffix.lower()
        if kind not in (None, *_KINDS):
            raise ConfigurationError(
                "Unknown kind of file.", got=self.out, allowed=" or ".join(_KINDS), hint="--out episode.png"
            )
        if self.out is None:
            from lerobot_adamanip.datasets.view import viewer

            viewer.require_display()
        from lerobot_adamanip.datasets.view.episode import read_episode

        with contextlib.redirect_stdout(sys.stderr):
            episode = read_episode(self.root, self.episode, images=kind != ".png")
        print(episode.title)
        if self.out is None:
            viewer.spawn(episode)
        else:
            _write(episode, self.out)
        return 0


def _write(episode: ViewedEpisode, path: Path) -> None:
    if path.suffix.lower() == ".png":
        from lerobot_adamanip.datasets.view.picture import write_picture

        write_picture(episode, path)
    else:
        from lerobot_adamanip.datasets.view import viewer

        viewer.save(episode, path)
    print(f"written: {path}")
