"""`adamanip keyframes`: dense recordings of a robot to demonstrations."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.cli.arguments import DatasetFolders, print_result
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, IMAGE_SIZE
from lerobot_adamanip.hardware.features import FRONT_CAMERA

if TYPE_CHECKING:
    from lerobot_adamanip.recordings.convert import ConvertOptions

_STAGES = {"convert": "episodes read", "assemble": "episodes written", "merge": "episodes mixed"}


@dataclass
class Keyframes:
    """Writes the key frames of dense recordings as a dataset that policies train on.

    A recording is what `lerobot-record` made of one of our robots. Datasets of key frames, of `adamanip collect` for
    instance, may be named as well: their episodes follow those of the recordings, as they are.
    """

    sources: DatasetFolders
    """Folders of recordings, and of datasets to be mixed with them."""

    out: Path
    """Folder of the new dataset."""

    camera: str = FRONT_CAMERA
    """Camera whose depth becomes the cloud."""

    calibration: Path | None = None
    """File that says where the camera stood. By default the one that the robot has left in each recording."""

    num_points: int = DEFAULT_NUM_POINTS
    """Points per cloud. In a mix, as many as the other datasets have."""

    images: bool = True
    """Whether there are pictures beside the clouds."""

    workspace_lower: tuple[float, float, float] = DEFAULT_WORKSPACE.lower
    """Box of the clouds, robot base frame [m]: its lower corner."""

    workspace_upper: tuple[float, float, float] = DEFAULT_WORKSPACE.upper
    """And its upper one."""

    stopped: float = 0.02
    """An arm slower than this stands still [m/s]."""

    same_place: float = 0.01
    """Two poses this close are one [m]."""

    given_up: float = 0.03
    """A target that is replaced while still this far away was given up [m]."""

    reached: float = 0.012
    """A target this close was reached; farther ones have stalled [m]."""

    successful: bool = False
    """Count episodes of roll-outs, which do not tell of success, as successes."""

    skip_still: bool = False
    """Leave episodes out in which nothing moves, instead of ending with an error."""

    repo_id: str | None = None
    """Name of the new dataset. local/<folder name> by default."""

    json: bool = False
    """Print one JSON object instead of text."""

    def options(self) -> ConvertOptions:
        """Returns the converter's options."""
        from lerobot_adamanip.recordings.convert import ConvertOptions
        from lerobot_adamanip.recordings.keyframe_choice import KeyFrameOptions
        from lerobot_adamanip.recordings.rows import RowOptions

        return ConvertOptions(
            key_frames=KeyFrameOptions(self.stopped, self.same_place, self.given_up, reached_position=self.reached),
            rows=RowOptions(
                self.num_points,
                IMAGE_SIZE if self.images else None,
                Workspace(self.workspace_lower, self.workspace_upper),
            ),
            camera=self.camera,
            calibration=self.calibration,
            successful=self.successful,
            skip_still=self.skip_still,
            repo_id=self.repo_id,
        )

    def run(self) -> int:
        """Converts; 0 when the dataset is complete."""
        from lerobot_adamanip.recordings.convert import convert

        with show_progress(_STAGES) as progress:
            made = convert(self.sources, self.out, self.options(), progress)
        mixed = f", and {made.simulated} of other datasets" if made.simulated else ""
        counts = f"{made.episodes} episodes, {made.key_frames} key frames of {made.ticks} ticks"
        skipped = [f"left out, nothing moves in it: {name}" for name in made.skipped]
        text = "\n".join([f"{counts}{mixed}, in {self.out}", *skipped])
        print_result(self.json, {"out": self.out, **asdict(made)}, text)
        return 0
