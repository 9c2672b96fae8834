"""Batches that are read at once equal those that LeRobot reads row by row, for marked datasets alone."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import torch
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_adamanip.contract import schema
from lerobot_adamanip.lerobot_patches import NO_PATCHES, batched_reading
from lerobot_adamanip.util.arrow import numeric_array

LENGTHS = (5, 8, 2)
CAMERA = schema.FRONT_IMAGE
FEATURES: dict[str, dict[str, Any]] = {
    "observation.point_cloud": {"dtype": "float32", "shape": (18,), "names": None},
    "observation.grid": {"dtype": "float32", "shape": (2, 3), "names": None},
    "observation.precise": {"dtype": "float64", "shape": (2,), "names": None},
    "observation.bytes": {"dtype": "uint8", "shape": (3,), "names": None},
    "observation.touch": {"dtype": "bool", "shape": (1,), "names": None},
    "action": {"dtype": "float32", "shape": (4,), "names": None},
    "complementary_info.phase": {"dtype": "int64", "shape": (1,), "names": None},
}
VIDEO = {CAMERA: {"dtype": "video", "shape": (64, 64, 3), "names": ["height", "width", "channels"]}}


def _record(path: Path, features: dict[str, dict[str, Any]]) -> Path:
    draw = np.random.default_rng(5)
    dataset = LeRobotDataset.create("local/reader", fps=4, features=features, root=path)
    for episode, length in enumerate(LENGTHS):
        for index in range(length):
            frame: dict[str, Any] = {"task": f"task {episode}"}
            for key, feature in features.items():
                shape, dtype = feature["shape"], feature["dtype"]
                if dtype == "string":
                    frame[key] = f"{episode}.{index}"
                elif dtype == "video":
                    frame[key] = draw.integers(0, 256, shape, dtype=np.uint8)
                else:
                    frame[key] = draw.normal(scale=100, size=shape).astype(dtype)
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()
    return path


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Episodes of `LENGTHS` rows with a video and every kind of number. Not to be written to."""
    return _record(tmp_path_factory.mktemp("reader") / "dataset", FEATURES | VIDEO)


@pytest.fixture(autouse=True)
def _lerobot_as_it_is() -> Iterator[None]:
    """Before and after, whatever the other tests run with."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(NO_PATCHES, raising=False)
        yield
    if "__getitems__" in vars(LeRobotDataset):
        del LeRobotDataset.__getitems__


def _opened(root: Path, **options: Any) -> LeRobotDataset:
    return LeRobotDataset("local/reader", root=root, video_backend="pyav", **options)


def _assert_same(one: dict[str, Any], other: dict[str, Any], without: tuple[str, ...] = ()) -> None:
    assert {key for key in one if key not in without} == set(other)
    for key, value in other.items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == one[key].dtype, key
            assert value.shape == one[key].shape, key
            assert torch.equal(value, one[key]), key
        else:
            assert value == one[key], key


WINDOWS = {
    "observation.point_cloud": [-0.25, 0.0],
    "action": [-0.5, 0.0, 0.25],
    CAMERA: [0.0],
    "observation.touch": [0.25],
}


@pytest.mark.parametrize("episodes", [None, [1], [0, 2]], ids=str)
@pytest.mark.parametrize("windows", [None, WINDOWS], ids=["rows", "windows"])
def test_items_are_those_of_lerobot_less_the_videos(
    root: Path, episodes: list[int] | None, windows: dict[str, list[float]] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = _opened(root, episodes=episodes, delta_timestamps=windows)
    wanted = [dataset[index] for index in range(len(dataset))]
    assert CAMERA in wanted[0]
    batched_reading.read_in_batches(dataset.meta)
    monkeypatch.setattr(DatasetReader, "_query_videos", lambda *_: pytest.fail("a video was decoded"))
    for item, expected in zip(dataset.__getitems__(range(len(dataset))), wanted, strict=True):
        _assert_same(expected, item, without=(CAMERA,))
    order = [1, 0, 1]
    for item, index in zip(dataset.__getitems__(order), order, strict=True):
        _assert_same(wanted[index], item, without=(CAMERA,))


def test_a_dataset_that_no_policy_has_marked_is_read_by_lerobot(root: Path) -> None:
    marked, other = _opened(root), _opened(root)
    batched_reading.read_in_batches(marked.meta)
    items = other.__getitems__([2, 3])
    for item, index in zip(items, (2, 3), strict=True):
        _assert_same(other[index], item)
    assert CAMERA in items[0]


def test_an_item_can_be_written_to(root: Path) -> None:
    dataset = _opened(root)
    batched_reading.read_in_batches(dataset.meta)
    first = dataset.__getitems__([0])[0]
    known = copy.deepcopy(first)
    first["action"] += 1.0
    _assert_same(known, dataset.__getitems__([0])[0])


def test_the_mark_brings_the_patch_into_a_new_process(root: Path) -> None:
    dataset = _opened(root)
    batched_reading.read_in_batches(dataset.meta)
    sent = pickle.dumps(dataset)
    del LeRobotDataset.__getitems__
    received = pickle.loads(sent)
    assert CAMERA not in received.__getitems__([0])[0]


def test_a_lerobot_that_reads_batches_itself_stays_as_it_is(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = lambda self, indices: [self[index] for index in indices]  # noqa: E731
    monkeypatch.setattr(LeRobotDataset, "__getitems__", own, raising=False)
    batched_reading.read_in_batches(_opened(root).meta)
    assert LeRobotDataset.__getitems__ is own


def test_without_patches_the_same_items_are_read_row_by_row(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(NO_PATCHES, "1")
    dataset = _opened(root)
    batched_reading.read_in_batches(dataset.meta)
    assert "__getitems__" not in vars(LeRobotDataset)
    assert CAMERA in next(iter(torch.utils.data.DataLoader(dataset, batch_size=2)))


@pytest.mark.parametrize(
    "column",
    [
        pa.array(["a", "b"]),
        pa.array([1.0, None]),
        pa.array([[1.0], [2.0, 3.0, 4.0]]),
        pa.array([[1.0, None], [2.0, 3.0]]),
    ],
    ids=["text", "null", "ragged", "null inside"],
)
def test_what_is_no_plain_array_is_no_array(column: pa.Array) -> None:
    assert numeric_array(column) is None


def test_slices_of_arrow_memory_keep_their_rows() -> None:
    for kind in (pa.list_(pa.float32()), pa.list_(pa.float32(), 2), pa.large_list(pa.int64())):
        values = numeric_array(pa.array([[1, 2], [3, 4], [5, 6]], type=kind).slice(1, 2))
        assert values is not None
        assert values.tolist() == [[3, 4], [5, 6]]
