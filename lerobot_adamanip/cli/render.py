"""`adamanip render`: adds pictures to a dataset that was collected without them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.cli.arguments import DatasetFolder, print_result
from lerobot_adamanip.cli.progress import show_progress


@dataclass
class RenderCommand:
    """Writes a copy of a dataset and adds the images that `adamanip collect --no-images` skipped.

    Creates scenes from their seeds and sets the recorded joint positions, without physics. Takes cameras and source of
    pictures from the collection; the source render needs a Vulkan device. After an interruption the same command
    resumes.
    """

    root: DatasetFolder
    """Folder of a dataset without images."""

    out: Path | None = None
    """Folder of the new dataset. Default: DIR-images."""

    assets: Path | None = None
    """Folder of external assets, if the dataset was recorded with any."""

    repo_id: str | None = None
    """Name of the new dataset in its card. Default: local/<folder name>."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Renders images. Returns 0 for a complete dataset."""
        from lerobot_adamanip.collection.render import add_pictures
        from lerobot_env_adamanip.make_environment import make_environment

        root = self.root.absolute()
        out = self.out or root.with_name(root.name + "-images")
        with show_progress({"render": "rendered", "assemble": "writing the dataset"}) as progress:
            episodes = add_pictures(
                root, out, make_environment, assets=self.assets, repo_id=self.repo_id, progress=progress
            )
        print_result(self.json, {"out": out, "episodes": episodes}, f"{episodes} episodes with images in {out}")
        return 0
