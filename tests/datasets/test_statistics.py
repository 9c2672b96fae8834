"""`meta/stats.json` holds the statistics of all rows, whatever wrote the dataset; clouds have none by episode."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from sound_demos import collect_sound

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.datasets.editing import filter_episodes, merge, split_episodes
from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled
from lerobot_adamanip.datasets.repair import repair
from lerobot_adamanip.datasets.statistics import QUANTILES, cloud_statistics

STATS = Path("meta/stats.json")


def columns(root: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(sorted((root / "data").glob("*/*.parquet")))
    return {name: np.asarray(table[name].to_pylist(), np.float64) for name in table.column_names}


def assert_true(root: Path) -> None:
    """Asserts that the statistics are numpy's of all rows."""
    told, found = json.loads((root / STATS).read_text()), columns(root)
    assert set(found) <= set(told)
    assert list(told) == sorted(told)
    for key, values in found.items():
        if key == schema.POINT_CLOUD:
            continue
        rows = values.reshape(len(values), -1)
        for name, share in QUANTILES.items():
            np.testing.assert_allclose(told[key][name], np.quantile(rows, share, axis=0), atol=1e-9, err_msg=key)
        for name in ("min", "max", "mean", "std"):
            np.testing.assert_allclose(told[key][name], getattr(rows, name)(axis=0), atol=1e-9, err_msg=key)
        assert told[key]["count"] == [len(rows)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sound dataset without pictures. Not to be written to."""
    return collect_sound(tmp_path_factory.mktemp("whole") / "whole", observe_images=False)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another one."""
    return collect_sound(tmp_path_factory.mktemp("other") / "other", observe_images=False, seed=1)


def test_every_command_writes_the_statistics_of_all_rows(whole: Path, other: Path, tmp_path: Path) -> None:
    filter_episodes(whole, ["episode_index=1,4"], tmp_path / "filtered")
    split_episodes(whole, tmp_path / "parts", {"a": 0.5, "b": 0.5})
    merge([whole, other], tmp_path / "merged")
    for root in (whole, *(tmp_path / name for name in ("filtered", "parts/a", "parts/b", "merged"))):
        assert_true(root)


def test_a_cloud_has_statistics_by_axis_for_all_points_and_none_by_episode(whole: Path) -> None:
    told = json.loads((whole / STATS).read_text())[schema.POINT_CLOUD]
    clouds = columns(whole)[schema.POINT_CLOUD]
    points = as_points(clouds).reshape(-1, 3)
    for name in ("min", "max", "mean", "std"):
        by_axis = as_points(np.asarray(told[name]))
        np.testing.assert_allclose(by_axis, np.broadcast_to(getattr(points, name)(axis=0), by_axis.shape), atol=1e-6)
    for path in (whole / "meta" / "episodes").rglob("*.parquet"):
        names = pq.read_schema(path).names
        assert f"stats/{schema.STATE}/mean" in names
        assert not [name for name in names if name.startswith(f"stats/{schema.POINT_CLOUD}")]
    assert not [name for name in Dataset(whole).table.column_names if name.startswith("stats/")]


def test_quantiles_of_clouds_are_true_to_a_tenth_of_a_millimetre() -> None:
    draw = np.random.default_rng(0)
    clouds = draw.uniform((-0.3, 0.2, 0.5), (0.8, 0.3, 1.4), (40, 64, 3)).astype(np.float32)
    stats = cloud_statistics(iter(np.array_split(clouds.reshape(40, -1), 3)))
    for name, share in QUANTILES.items():
        expected = np.quantile(clouds.reshape(-1, 3), share, axis=0, method="inverted_cdf")
        assert np.abs(as_points(stats[name]) - expected).max() < 1.01e-4
    far = cloud_statistics([np.array([[1e6, -1e6, np.nan], [1.0, 2.0, 3.0]], np.float32)])
    assert (far["max"].tolist(), far["count"].tolist()) == ([1.0, 2.0, 3.0], [2])


# What LeRobot's tools leave ------------------------------------------------------------------------------------------


def test_after_edits_by_lerobot_a_check_passes_with_warnings_that_a_repair_mends(
    whole: Path, other: Path, tmp_path: Path
) -> None:
    from lerobot.datasets.dataset_tools import add_features, delete_episodes, merge_datasets

    source = open_dataset(whole)
    deleted = delete_episodes(source, [1, 4], output_dir=tmp_path / "deleted", repo_id="local/deleted")
    merge_datasets([source, open_dataset(other)], output_repo_id="local/merged", output_dir=tmp_path / "merged")
    reward = (np.ones(len(deleted), np.float32), {"dtype": "float32", "shape": (1,), "names": None})
    add_features(deleted, {"next.reward": reward}, output_dir=tmp_path / "added", repo_id="local/added")
    for name in ("deleted", "added", "merged"):
        root = tmp_path / name
        report = check(root)
        assert report.clean, report.findings
        assert set(report.counts) == {"averaged"}
        assert main(["check", str(root)]) == 0
        assert repair(root).left == []
        assert check(root).findings == []
        assert_true(root)


def test_a_repair_keeps_fixed_ranges_of_poses(whole: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(whole, tmp_path / "copy"))
    leave_poses_unscaled(root)
    fixed = json.loads((root / STATS).read_text())
    for name, value in schema.FIXED_STATISTICS.items():
        assert set(np.asarray(fixed[schema.ACTION][name])[list(schema.FIXED_RANGE_DIMS)]) == {value}
    assert check(root).findings == []
    broken = json.loads(json.dumps(fixed))
    broken[schema.STATE]["q10"] = [0.0] * schema.STATE_DIM
    (root / STATS).write_text(json.dumps(broken))
    assert set(check(root).counts) == {"averaged"}
    assert [line.partition(":")[0] for line in repair(root).mended] == [STATS.as_posix()]
    assert json.loads((root / STATS).read_text()) == fixed
