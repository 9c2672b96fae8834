"""`adamanip keyframes`: converts recordings and simulated datasets at control rate to demonstrations in key frames."""

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
class KeyframesCommand:
    """Writes the key frames of recordings, or of a simulated dataset at control rate, as a dataset of its own.

    A recording is a dataset that `lerobot-record` wrote with one of our robots. You may add datasets of key frames,
    e.g. from `adamanip collect`. Their episodes follow those of the recordings unchanged.

    A simulated dataset needs `adamanip collect DIR --control dense --cloud --effort --state full`, and is converted
    alone. Its rows name their key frames, so only --no-images and --repo-id apply.
    """

    sources: DatasetFolders
    """Folders of recordings and of datasets to mix with them."""

    out: Path
    """Folder of the new dataset."""

    camera: str = FRONT_CAMERA
    """Camera whose depth becomes the cloud."""

    calibration: Path | None = None
    """Camera calibration file. Default: the file that the robot stored in each recording."""

    num_points: int = DEFAULT_NUM_POINTS
    """Number of points per cloud. A mix uses the number of the other datasets."""

    images: bool = True
    """Whether to write pictures in addition to clouds."""

    workspace_lower: tuple[float, float, float] = DEFAULT_WORKSPACE.lower
    """Lower corner of the box of the clouds, robot base frame [m]."""

    workspace_upper: tuple[float, float, float] = DEFAULT_WORKSPACE.upper
    """Upper corner of the box of the clouds, robot base frame [m]."""

    stopped: float = 0.02
    """Speed below which the arm stands still [m/s]."""

    same_place: float = 0.01
    """Distance below which two poses are equal [m]."""

    given_up: float = 0.03
    """Distance [m] above which a replaced target counts as abandoned."""

    reached: float = 0.012
    """Distance [m] below which a target counts as reached; farther ones count as stalled."""

    successful: bool = False
    """Count each episode as a success at its last row, if the recording holds no success, e.g. a rollout. Of
    interventions, only one that lasts to the end of its episode counts."""

    skip_still: bool = False
    """Skip episodes without motion instead of ending with an error."""

    repo_id: str | None = None
    """Name of the new dataset. Default: local/<folder name>."""

    json: bool = False
    """Print one JSON object instead of text."""

    def options(self) -> ConvertOptions:
        """Returns the converter's options."""
        from lerobot_adamanip.recordings.convert import ConvertOptions
        from lerobot_adamanip.recordings.rows import RowOptions
        from lerobot_adamanip.recordings.sparsify import KeyFrameOptions

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
        """Converts recordings. Returns 0 for a complete dataset."""
        from lerobot_adamanip.collection.key_frames import dense_collections

        if dense_collections(self.sources):
            return self._convert_simulated()
        from lerobot_adamanip.recordings.convert import convert

        with show_progress(_STAGES) as progress:
            result = convert(self.sources, self.out, self.options(), progress)
        mixed = f", and {result.simulated} of other datasets" if result.simulated else ""
        counts = f"{result.episodes} episodes, {result.key_frames} key frames of {result.ticks} ticks"
        skipped = [f"skipped, nothing moves in it: {name}" for name in result.skipped]
        text = "\n".join([f"{counts}{mixed}, in {self.out}", *skipped])
        print_result(self.json, {"out": self.out, **asdict(result)}, text)
        return 0

    def _convert_simulated(self) -> int:
        from lerobot_adamanip.collection.key_frames import require_one_source, write_key_frames

        source = require_one_source(self.sources)
        with show_progress(_STAGES) as progress:
            episodes, key_frames = write_key_frames(
                source, self.out, images=self.images, repo_id=self.repo_id, progress=progress
            )
        text = f"{episodes} episodes, {key_frames} key frames, in {self.out}"
        print_result(self.json, {"out": self.out, "episodes": episodes, "key_frames": key_frames}, text)
        return 0
