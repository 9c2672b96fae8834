"""Assembly: whoever prepares the episodes, the dataset is the same; and it is what LeRobot's own writer makes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from demos_helpers import Preparing, fakes, make_spec, patiently, same_bytes

from lerobot_adamanip.collection import assemble as assembling
from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.appending import can_append, in_order
from lerobot_adamanip.util import jobs

SPEC: dict[str, Any] = {"episodes_per_object": 4, "num_points": 64}


@pytest.fixture
def small_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files so small that several are begun, as in large collections."""
    create = assembling.create_dataset

    def created(*arguments: Any, **options: Any) -> Any:
        dataset = create(*arguments, **options)
        dataset.meta.update_chunk_settings(data_files_size_in_mb=0.02, video_files_size_in_mb=0.004)
        return dataset

    monkeypatch.setattr(assembling, "create_dataset", created)


def test_the_writer_at_hand_can_be_appended_to(tmp_path: Path) -> None:
    dataset = assembling.create_dataset(tmp_path / "new", "local/new", features=schema.dataset_features(8, cameras=()))
    assert can_append(dataset)
    del dataset.writer._latest_episode
    assert not can_append(dataset)


def collected(folder: Path, *, spec: dict[str, Any] | None = None, **options: Any) -> Path:
    collect(folder / "dataset", make_spec(**SPEC, **(spec or {})), fakes(), patiently(**options))
    return folder / "dataset"


def without_cloud(names: Any) -> Any:
    """Statistics of clouds are computed here, to within a bin of LeRobot's histograms: see `test_check`."""
    kept = [name for name in names if not name.removeprefix("stats/").startswith(schema.POINT_CLOUD)]
    return {name: names[name] for name in kept} if isinstance(names, dict) else kept


def same_but_for_a_cache_name(one: Path, stock: Path) -> None:
    """LeRobot's writer names an entry of its cache in the schema of a table; rows are equal, and all other files."""
    assert [path.relative_to(one) for path in sorted(one.rglob("*"))] == [
        path.relative_to(stock) for path in sorted(stock.rglob("*"))
    ]
    for path in filter(Path.is_file, sorted(one.rglob("*"))):
        other = stock / path.relative_to(one)
        if path.parent.parent.name == "data":
            assert pq.read_table(path).equals(pq.read_table(other))
            assert pq.read_metadata(path).num_row_groups == pq.read_metadata(other).num_row_groups
        elif path.name == "stats.json":
            assert without_cloud(json.loads(path.read_text())) == without_cloud(json.loads(other.read_text()))
        elif path.parent.parent.name == "episodes":
            one_table, other_table = (pq.read_table(each) for each in (path, other))
            kept = without_cloud(one_table.column_names)
            assert one_table.select(kept).equals(other_table.select(kept))
            assert one_table.column_names == other_table.column_names
        else:
            assert path.read_bytes() == other.read_bytes(), path


@pytest.mark.nightly
@pytest.mark.usefixtures("small_files", "in_process")
def test_two_processes_one_and_lerobot_itself_make_the_same_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = collected(tmp_path / "one")
    assert len(list((one / "data").rglob("*.parquet"))) > 1
    assert len(list((one / "videos").rglob("*.mp4"))) > 1
    with monkeypatch.context() as patch:
        patch.setattr(assembling, "MIN_EPISODES_PER_WORKER", 1)
        patch.setattr(jobs, "WorkerPool", Preparing)
        same_bytes(one, collected(tmp_path / "two", workers=2))
    monkeypatch.setattr(assembling, "can_append", lambda _: False)
    same_but_for_a_cache_name(one, collected(tmp_path / "stock"))


@pytest.mark.usefixtures("in_process")
def test_so_does_a_collection_without_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = {"observe_images": False}
    one = collected(tmp_path / "one", spec=images)
    assert not (one / "videos").exists()
    with monkeypatch.context() as patch:
        patch.setattr(assembling, "MIN_EPISODES_PER_WORKER", 1)
        patch.setattr(jobs, "WorkerPool", Preparing)
        same_bytes(one, collected(tmp_path / "two", spec=images, workers=2))
    monkeypatch.setattr(assembling, "can_append", lambda _: False)
    same_but_for_a_cache_name(one, collected(tmp_path / "stock", spec=images))


def test_what_comes_in_any_order_leaves_in_its_own() -> None:
    assert list(in_order(iter([(2, "c"), (0, "a"), (1, "b"), (3, "d")]))) == ["a", "b", "c", "d"]
