"""A small collection of the fake environment, and what it means for two datasets to be equal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

HERE = str(Path(__file__).parent)
OPTIONS = {
    "category": "fake",
    "objects": ("fake_000", "fake_001"),
    "episodes_per_object": 3,
    "num_points": 8,
    "image_size": 64,
    "env_factory": "demos_fake_env:make_env",
    "expert_factory": "demos_fake_env:make_expert",
}
ATTEMPTS = 25


def same_content(first: Path, second: Path) -> None:
    """Asserts that two datasets hold the same rows, the same frames after decoding, and the same per-episode facts."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    files = sorted(path.relative_to(first) for path in first.rglob("*.parquet"))
    assert files == sorted(path.relative_to(second) for path in second.rglob("*.parquet"))
    for name in files:
        assert pq.read_table(first / name).equals(pq.read_table(second / name)), name
    for name in ("meta/stats.json", "meta/info.json", "meta/cameras.json", "meta/collection.json"):
        assert (first / name).read_text() == (second / name).read_text(), name
    one, other = (LeRobotDataset("local/x", root=root, video_backend="pyav") for root in (first, second))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a["observation.images.front"], b["observation.images.front"])
