from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.shards import RecordedEpisode, read_record, read_shard, write_shard
from lerobot_adamanip.util.errors import DatasetError


@pytest.fixture
def episode() -> RecordedEpisode:
    generator = np.random.default_rng(0)
    return RecordedEpisode(
        {
            schema.STATE: generator.normal(size=(5, 24)).astype(np.float32),
            schema.ACTION: generator.normal(size=(5, 10)).astype(np.float32),
            schema.TRIAL: generator.integers(0, 3, (5, 1)),
            schema.FRONT_IMAGE: generator.integers(0, 256, (5, 16, 16, 3), dtype=np.uint8),
        },
        {"object_id": "safe_000", "hidden_state": {"locked": True, "angle": 0.25}, "seed": 2**30},
    )


def test_an_episode_comes_back_bit_for_bit(tmp_path: Path, episode: RecordedEpisode) -> None:
    write_shard(tmp_path / "a", episode)
    back = read_shard(tmp_path / "a")
    assert back.record == episode.record == read_record(tmp_path / "a")
    assert set(back.columns) == set(episode.columns)
    for key, value in episode.columns.items():
        assert back.columns[key].dtype == value.dtype
        np.testing.assert_array_equal(back.columns[key], value)


def test_a_file_cut_anywhere_is_not_an_episode(tmp_path: Path, episode: RecordedEpisode) -> None:
    write_shard(tmp_path / "a", episode)
    content = (tmp_path / "a").read_bytes()
    for size in (0, 4, 200, len(content) // 2, len(content) - 1):
        (tmp_path / "b").write_bytes(content[:size])
        assert read_record(tmp_path / "b") is None
        with pytest.raises(DatasetError, match="recorded episode"):
            read_shard(tmp_path / "b")
