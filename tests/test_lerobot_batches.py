"""Batches read at once are those that torch collates from single items, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from readers import FPS, assert_same, opened

from lerobot_adamanip import columns, lerobot_compat, schema
from lerobot_adamanip.lerobot_batches import CollatedItems

LENGTHS = (5, 8, 2)
CAMERA, CLOUD, NOTE = "observation.images.front", "observation.point_cloud", "complementary_info.note"
NUMERIC: dict[str, dict[str, Any]] = {
    CLOUD: {"dtype": "float32", "shape": (6, 3), "names": None},
    "observation.precise": {"dtype": "float64", "shape": (2,), "names": None},
    "observation.bytes": {"dtype": "uint8", "shape": (3,), "names": None},
    "observation.touch": {"dtype": "bool", "shape": (1,), "names": None},
    "action": {"dtype": "float32", "shape": (schema.ACTION_DIM,), "names": list(schema.POSE_NAMES)},
    "complementary_info.phase": {"dtype": "int64", "shape": (1,), "names": None},
}
VIDEO = {"dtype": "video", "shape": (64, 64, 3), "names": ["height", "width", "channels"]}
TEXT = {"dtype": "string", "shape": (1,), "names": None}
WINDOWS = {
    CLOUD: [-1, 0],
    "observation.precise": [0],
    "observation.bytes": [-2, 0],
    "observation.touch": [0, 1],
    "complementary_info.phase": [-1, 0, 1],
    "action": list(range(-3, 4)),
}


def recorded(path: Path, features: dict[str, dict[str, Any]]) -> Path:
    """Records episodes of `LENGTHS` frames of random numbers."""
    rng = np.random.default_rng(6)
    dataset = LeRobotDataset.create("local/reader", fps=FPS, features=features, root=path)
    for episode, length in enumerate(LENGTHS):
        for index in range(length):
            frame: dict[str, Any] = {"task": f"task {episode}"}
            for key, feature in features.items():
                if feature is TEXT:
                    frame[key] = f"{episode}.{index}"
                elif feature is VIDEO:
                    frame[key] = rng.integers(0, 256, feature["shape"], np.uint8)
                else:
                    frame[key] = rng.normal(scale=100, size=feature["shape"]).astype(feature["dtype"])
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()
    return path


@pytest.fixture(scope="module")
def numeric_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Numbers and a video, as in this project's datasets. Not to be written to."""
    return recorded(tmp_path_factory.mktemp("reader") / "numeric", {**NUMERIC, CAMERA: VIDEO})


@pytest.fixture(autouse=True)
def _reader_as_before() -> Iterator[None]:
    was_applied = lerobot_dataset.DatasetReader is not DatasetReader
    yield
    (lerobot_compat.apply if was_applied else lerobot_compat.restore)()


def batches(dataset: LeRobotDataset, **options: Any) -> list[dict[str, Any]]:
    """Every item in an order of its own, and some twice, as a DataLoader gives them."""
    order = np.random.default_rng(0).permutation(len(dataset)).tolist() * 2
    return list(torch.utils.data.DataLoader(dataset, batch_size=4, sampler=order[: len(dataset) + 3], **options))


@pytest.mark.parametrize(
    "options",
    [{}, {"deltas": WINDOWS}, {"deltas": {"action": [0]}, "episodes": [1]}, {"deltas": WINDOWS, "episodes": [0, 2]}],
    ids=["rows", "windows", "one step of an episode", "windows of some episodes"],
)
@pytest.mark.parametrize("narrow", [1024, 0], ids=["joined", "in pieces"])
@pytest.mark.parametrize("latest", [(), ("observation.point_cloud",)], ids=["whole", "latest"])
def test_batches_equal_collated_items(
    numeric_root: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any], narrow: int, latest: tuple[str]
) -> None:
    monkeypatch.setattr(columns, "NARROW_BYTES", narrow)
    dataset = opened(numeric_root, lerobot_compat.apply, **options)
    lerobot_compat.skip_videos(dataset.meta)
    lerobot_compat.read_latest_only(dataset.meta, *latest)
    assert isinstance(dataset.__getitems__([0, 1]), CollatedItems)
    found = batches(dataset)
    monkeypatch.delattr(LeRobotDataset, "__getitems__")
    for one, other in zip(batches(dataset), found, strict=True):
        assert_same(one, other)


def test_data_loading_processes_give_the_same_batches(numeric_root: Path) -> None:
    dataset = opened(numeric_root, lerobot_compat.apply, deltas=WINDOWS)
    lerobot_compat.skip_videos(dataset.meta)
    for one, other in zip(batches(dataset), batches(dataset, num_workers=1), strict=True):
        assert_same(one, other)


@pytest.mark.parametrize("seen", ["video", "text"])
def test_what_is_no_number_is_read_one_by_one(tmp_path: Path, numeric_root: Path, seen: str) -> None:
    root = numeric_root if seen == "video" else recorded(tmp_path / "text", {**NUMERIC, NOTE: TEXT})
    dataset = opened(root, lerobot_compat.apply, deltas={"action": [-1, 0]})
    items = dataset.__getitems__([3, 0])
    assert isinstance(items, list)
    for index, item in zip([3, 0], items, strict=True):
        assert_same(dataset[index], item)


def test_a_collate_function_of_ones_own_sees_items(numeric_root: Path) -> None:
    dataset = opened(numeric_root, lerobot_compat.apply, deltas=WINDOWS)
    lerobot_compat.skip_videos(dataset.meta)
    loader = torch.utils.data.DataLoader(dataset, batch_size=5, collate_fn=lambda items: list(items)[::-1])
    for place, item in enumerate(reversed(next(iter(loader)))):
        assert_same(dataset[place], item)
    subset = torch.utils.data.Subset(dataset, [7, 2, 9])
    assert next(iter(torch.utils.data.DataLoader(subset, batch_size=3)))["index"].tolist() == [7, 2, 9]
    items = dataset.__getitems__([1, 2])
    assert_same(dict(items[-1]), dict(items[0:2][1]))
    with pytest.raises(IndexError):
        items[2]


def test_rows_that_are_not_there_are_an_error(numeric_root: Path) -> None:
    dataset = opened(numeric_root, lerobot_compat.apply, deltas=WINDOWS)
    lerobot_compat.skip_videos(dataset.meta)
    assert dataset.__getitems__([-1])[0]["index"] == len(dataset) - 1
    for wrong in (len(dataset), -len(dataset) - 1):
        with pytest.raises(IndexError):
            dataset.__getitems__([0, wrong])


def test_without_the_faster_reader_datasets_have_no_batches() -> None:
    assert lerobot_compat.apply()
    assert hasattr(LeRobotDataset, "__getitems__")
    lerobot_compat.restore()
    assert not hasattr(LeRobotDataset, "__getitems__")


def test_a_dataset_read_anew_with_other_marks_gives_other_windows(numeric_root: Path) -> None:
    key, dataset = "observation.point_cloud", opened(numeric_root, lerobot_compat.apply, deltas=WINDOWS)
    lerobot_compat.skip_videos(dataset.meta)
    assert dataset.__getitems__([4])[0][key].shape[0] == 2
    lerobot_compat.read_latest_only(dataset.meta, key)
    assert dataset.__getitems__([4])[0][key].shape[0] == 1
