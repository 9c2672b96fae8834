"""Changes how LeRobot reads datasets, for ours alone, in LeRobot versions it was tested with.

LeRobot keeps its own reader, untouched, for every other dataset and in every other version; see
`lerobot_adamanip.lerobot_reader` for what the faster one does. Nothing here fails if LeRobot renames something.

A plugin must stay light, so it calls `apply` only where ``lerobot.datasets.lerobot_dataset`` is already loaded, as in
lerobot-train. Scripts of one's own call `apply`. The other places that change LeRobot are
`lerobot_adamanip.lerobot_editing` and `lerobot_adamanip.lerobot_recording`.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip import UNSCALED_POSES, lerobot_version
from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.pose_statistics import flat_names, unscaled_poses
from lerobot_adamanip.schema import ACTION, LATEST_ONLY, POINT_CLOUD, POSE_NAMES, SKIP_VIDEOS

TESTED = {"0.6.1": "e594c630a264f01d"}
"""LeRobot version -> hash of its reader's source, for which `FastDatasetReader` was written and tested."""
_log = logging.getLogger(__name__)
_stock: type[Any] | None = None  # LeRobot's own reader, while it is replaced


def is_ours(features: Mapping[str, Any]) -> bool:
    """Whether a dataset's features follow this project's contract: a point cloud, and poses by name as actions."""
    return POINT_CLOUD in features and flat_names(features.get(ACTION)) == list(POSE_NAMES)


def is_tested() -> bool:
    """Whether this LeRobot's version, and its reader, are those that the faster reader was tested with."""
    return lerobot_version.is_tested(TESTED, _built_on)


def _built_on() -> tuple[Any, ...]:
    from lerobot.datasets.dataset_reader import DatasetReader

    return (DatasetReader,)


def apply() -> bool:
    """Makes `LeRobotDataset` read our datasets with the faster reader, and all others as before. Idempotent.

    Where `UNSCALED_POSES` is set, the metadata of our datasets has fixed ranges of rotation and gripper.

    Returns False, and warns once, for a LeRobot it was not tested with.

    Raises:
        ConfigurationError: `UNSCALED_POSES` is set, and this LeRobot was not tested.
    """
    global _stock  # noqa: PLW0603  (what LeRobot had is remembered once per process)
    if _stock is not None:
        return True
    unscaled = os.environ.get(UNSCALED_POSES, "") not in ("", "0")
    if not is_tested():
        if unscaled:
            raise _cannot_leave_unscaled()
        lerobot_version.warn_untested(_log, TESTED, "its own, slower dataset reader stays")
        return False
    from lerobot.datasets import lerobot_dataset

    from lerobot_adamanip import lerobot_batches, lerobot_offline, lerobot_streaming
    from lerobot_adamanip.lerobot_reader import FastDatasetReader

    stock = lerobot_dataset.DatasetReader

    def make_reader(meta: Any, *args: Any, **kwargs: Any) -> Any:
        if not is_ours(meta.features):
            return stock(meta, *args, **kwargs)
        if unscaled and meta.stats:
            meta.stats = unscaled_poses(meta.stats, meta.features)  # of which policies' normalisers are made
        return FastDatasetReader(meta, *args, **kwargs)

    _stock = stock
    lerobot_dataset.DatasetReader = make_reader
    lerobot_batches.register()
    lerobot_offline.register(is_ours)
    lerobot_streaming.register(is_ours)
    return True


def _cannot_leave_unscaled() -> ConfigurationError:
    import lerobot

    return ConfigurationError(
        f"{UNSCALED_POSES} has no effect with this LeRobot.",
        got=f"lerobot {lerobot.__version__}",
        allowed=", ".join(TESTED),
        hint=f"pip install 'lerobot=={next(iter(TESTED))}', or {UNSCALED_POSES}=0",
    )


def restore() -> None:
    """Puts LeRobot's own reader back for all datasets: for comparison."""
    global _stock
    if _stock is not None:
        from lerobot.datasets import lerobot_dataset

        lerobot_dataset.DatasetReader, _stock = _stock, None
        if "__getitems__" in vars(lerobot_dataset.LeRobotDataset):
            del lerobot_dataset.LeRobotDataset.__getitems__


def skip_videos(dataset_meta: Any) -> None:
    """Marks a dataset as read by a policy that looks at no image.

    The mark is an attribute of the metadata, so it travels with the dataset into data-loading processes.
    """
    setattr(dataset_meta, SKIP_VIDEOS, True)


def read_latest_only(dataset_meta: Any, *keys: str) -> None:
    """Marks observations of which a policy looks at the latest step alone, however long the window of others is.

    LeRobot asks for the same steps of every observation: a memory of poses would read as many clouds.
    """
    setattr(dataset_meta, LATEST_ONLY, tuple(keys))


def item_milliseconds(dataset: Any, indices: Iterable[int]) -> float:
    """Returns the mean time of reading an item [ms]."""
    wanted = list(indices)
    started = time.perf_counter()
    for index in wanted:
        dataset[index]
    return 1e3 * (time.perf_counter() - started) / len(wanted)


def measure_reader(
    root: str | Path, delta_indices: dict[str, list[int]], *, items: int = 50, without_videos: bool = True
) -> dict[str, float]:
    """Compares LeRobot's own reader with the faster one on a dataset of ours.

    Args:
        root: folder of the dataset.
        delta_indices: key -> steps relative to the present, as a policy asks for them.
        items: read with each reader, spread over the dataset.
        without_videos: as `dp3_adaptive` reads it; False: as ACT does.

    Returns:
        ``stock_ms`` and ``fast_ms``: mean time of an item [ms]; ``speedup``: their ratio.
    """
    from lerobot.datasets import lerobot_dataset

    def measured(prepare: Callable[[], object]) -> float:
        prepare()
        plain = lerobot_dataset.LeRobotDataset("local/measured", root=root)
        deltas = {key: [step / plain.meta.fps for step in steps] for key, steps in delta_indices.items()}
        dataset = lerobot_dataset.LeRobotDataset("local/measured", root=root, delta_timestamps=deltas)
        if without_videos:
            skip_videos(dataset.meta)
        dataset[0]
        return item_milliseconds(dataset, np.linspace(0, len(dataset) - 1, items).astype(int).tolist())

    was_applied = _stock is not None
    try:
        stock, fast = measured(restore), measured(apply)
    finally:
        if not was_applied:
            restore()
    return {"stock_ms": stock, "fast_ms": fast, "speedup": stock / fast}
