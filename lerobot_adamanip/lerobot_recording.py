"""Makes LeRobot keep every finished episode of our robots' recordings, in LeRobot versions it was tested with.

LeRobot 0.6.1 writes what makes its files readable when a session ends: a kill loses all episodes of it. Here an
episode is on the disk, readable, when it has been saved, and `--resume=true` mends what a kill has left and goes on.
Datasets of other robots, and other versions of LeRobot, are left to LeRobot; see `lerobot_adamanip.lerobot_writer`.
"""

from __future__ import annotations

import functools
import logging
from pathlib import Path
from typing import Any

from lerobot_adamanip import lerobot_version
from lerobot_adamanip.hardware.features import is_dense

TESTED = {"0.6.1": "91402ca2eb139601"}
"""LeRobot version -> hash of the source of its writer, encoder and metadata, for which this was written and tested."""
_log = logging.getLogger(__name__)
_stock: dict[str, Any] = {}  # LeRobot's own, while they are replaced


def is_tested() -> bool:
    """Whether this LeRobot's version, and what this builds on, are those that it was tested with."""
    return lerobot_version.is_tested(TESTED, _built_on)


def _built_on() -> tuple[Any, ...]:
    from lerobot.datasets import io_utils
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
    from lerobot.datasets.dataset_writer import DatasetWriter
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.datasets.video_utils import StreamingVideoEncoder

    return (
        DatasetWriter,
        LeRobotDatasetMetadata,
        LeRobotDataset.resume,
        io_utils.write_info,
        io_utils.write_stats,
        StreamingVideoEncoder,
    )


def apply() -> bool:
    """Makes LeRobot's recorder keep finished episodes of our robots. Idempotent.

    Returns False, and warns once, for a LeRobot it was not tested with, which stays as it is.
    """
    if _stock:
        return True
    if not is_tested():
        lerobot_version.warn_untested(_log, TESTED, "a kill loses a recording's episodes")
        return False
    from lerobot.datasets import lerobot_dataset

    from lerobot_adamanip.lerobot_writer import DurableWriter

    stock, resume = lerobot_dataset.DatasetWriter, lerobot_dataset.LeRobotDataset.resume.__func__

    def make_writer(meta: Any, *args: Any, **kwargs: Any) -> Any:
        return (DurableWriter if is_dense(meta.features) else stock)(meta, *args, **kwargs)

    @functools.wraps(resume)
    def resume_mended(cls: type[Any], repo_id: str, root: str | Path | None = None, *args: Any, **kwargs: Any) -> Any:
        if root is not None:
            mend(Path(root))
        return resume(cls, repo_id, root, *args, **kwargs)

    _stock.update(writer=stock, resume=lerobot_dataset.LeRobotDataset.__dict__["resume"])
    lerobot_dataset.DatasetWriter = make_writer
    lerobot_dataset.LeRobotDataset.resume = classmethod(resume_mended)
    return True


def restore() -> None:
    """Puts LeRobot's own writer back for all datasets."""
    if _stock:
        from lerobot.datasets import lerobot_dataset

        lerobot_dataset.DatasetWriter = _stock["writer"]
        lerobot_dataset.LeRobotDataset.resume = _stock["resume"]
        _stock.clear()


def mend(root: Path) -> None:
    """Mends a recording of our robots that a kill has left; does nothing to any other dataset, or to none."""
    from lerobot_adamanip.demos.loading import read_info
    from lerobot_adamanip.hub.check.repair import repair

    try:
        if not is_dense(read_info(root)["features"]):
            return
    except (OSError, ValueError):
        return  # LeRobot says what is wrong
    done = repair(root)
    for line in done.lines():
        _log.warning("%s: %s", root.name, line)
