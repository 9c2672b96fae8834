"""`adamanip view`: look at an episode."""

from __future__ import annotations

import contextlib
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from lerobot_adamanip.datasets.view.episode import ViewedEpisode, read_episode
from lerobot_adamanip.util.errors import ConfigurationError


@dataclass
class View:
    """Shows an episode in rerun: cloud, tool path, goals, tries, phases, effort, pictures if there are any.

    Opens rerun's viewer, unless a file is to be written or --web is given. The viewer comes with lerobot[viz]. On a
    machine without a display, use --image, --save or --web.
    """

    root: tyro.conf.Positional[Path]
    """Folder of a dataset."""

    episode: int = 0
    """Index of the episode."""

    save: Path | None = None
    """Write a recording (.rrd) for rerun, which needs no display; `rerun FILE.rrd` shows it."""

    image: Path | None = None
    """Write a picture (.png) that shows the episode at a glance; needs no rerun."""

    web: bool = False
    """Serve it to browsers, until Ctrl-C. rerun listens on every address of this machine, without a password."""

    port: int = 9090
    """Of the page that --web shows."""

    def run(self) -> int:
        """Reads the episode and shows or writes it; 0."""
        if self.save is not None and self.save.suffix.lower() != ".rrd":
            raise ConfigurationError("Unknown kind of recording.", got=self.save, allowed=".rrd", hint="--save x.rrd")
        watched = self.image is None or self.save is not None or self.web
        if watched and self.save is None and not self.web:
            from lerobot_adamanip.datasets.view import viewer

            viewer.require_display()
        with contextlib.redirect_stdout(sys.stderr):
            episode = read_episode(self.root, self.episode, images=watched)
        print(episode.title)
        if self.image is not None:
            from lerobot_adamanip.datasets.view.still import write_still

            write_still(episode, self.image)
            print(f"picture: {self.image}")
        if watched:
            self._show(episode)
        return 0

    def _show(self, episode: ViewedEpisode) -> None:
        from lerobot_adamanip.datasets.view import viewer

        if self.save is not None:
            viewer.save(episode, self.save)
            print(f"recording: {self.save}")
        if self.web:
            print(f"{viewer.serve(episode, self.port)}  (Ctrl-C ends it)", flush=True)
            while True:
                time.sleep(3600)
        elif self.save is None:
            viewer.spawn(episode)
