"""`adamanip annotate`: annotates grasps and joints of external assets in the browser."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from lerobot_adamanip.cli.arguments import Category
from lerobot_adamanip.util.errors import ConfigurationError

AUTOSAVE_PERIOD = 1.0
"""Maximum time between a change and its draft file [s]."""


@dataclass
class AnnotateCommand:
    """Shows an object in the browser with a gripper at each part. Saves adamanip.json into the object's folder.

    Part poses are proposed from bounding boxes or from AdaManip's points; refine them by hand. Ctrl-C ends the tool.
    Unsaved changes are kept as a draft and loaded next time.
    """

    directory: Annotated[Path, tyro.conf.Positional]
    """Folder with a mobility.urdf, or a directory of such folders."""

    category: Category = "safe"
    """Category of the object."""

    host: str = "127.0.0.1"
    """Address of the page; 0.0.0.0 allows other machines."""

    port: int = 8080
    """Port of the page. If it is in use, a free port is taken."""

    def run(self) -> int:
        """Serves the page until interrupted. Returns 0."""
        folders = self._folders()
        server = start_viser(self.host, self.port)
        from lerobot_adamanip.cli.annotate.app import AnnotationApp

        print(f"open http://{'localhost' if self.host in ('127.0.0.1', '0.0.0.0') else self.host}:{server.get_port()}")
        app = AnnotationApp(server, folders, self.category)
        try:
            while True:
                time.sleep(AUTOSAVE_PERIOD)
                app.autosave()
        except KeyboardInterrupt:
            print("closed")
        finally:
            app.autosave()
            server.stop()
        return 0

    def _folders(self) -> list[Path]:
        from lerobot_adamanip.assets import AssetSource
        from lerobot_adamanip.assets.urdf import URDF_NAME

        if (self.directory / URDF_NAME).is_file():
            return [self.directory]
        source = AssetSource(self.directory)
        return [source.folder(identifier) for identifier in source.ids(self.category)]


def start_viser(host: str, port: int) -> Any:
    """Returns a viser server. Raises `ConfigurationError` if viser is not installed."""
    try:
        import viser
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            "The annotation tool needs a package that is not installed.",
            got="no module viser",
            allowed="viser",
            hint="pip install 'lerobot_env_adamanip[annotate]'",
        ) from error
    return viser.ViserServer(host=host, port=port, label="adamanip annotate", verbose=False)
