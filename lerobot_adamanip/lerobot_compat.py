"""The only place that touches LeRobot's private names. LeRobot is pinned to 0.6.x, for which this was written.

What is fixed: 0.6.1's dataset reader decodes every column of every row it needs into Python lists, which for point
clouds is what training would wait for; and it decodes videos for policies that look at none. Both fixes are guarded by
version, and both give what LeRobot's own reader gives, bit for bit (less the videos nobody looks at).

Importing this imports LeRobot's datasets. A plugin must stay light, so it imports this, and calls `apply`, only where
``lerobot.datasets.lerobot_dataset`` is already loaded, as it is in lerobot-train. Scripts of one's own call `apply`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import lerobot
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.envs.utils import _LazyAsyncVectorEnv, freeze_after_episode_end
from numpy.typing import NDArray

FIXED_VERSIONS = ("0.6.",)
STOCK_METHODS = ("_get_query_indices", "_get_query_timestamps", "_query_hf_dataset", "_query_videos", "get_item")
_SKIP_VIDEOS = "_adamanip_skip_videos"
_DEPTH_UNITS = "_image_depth_units"


class ColumnStore:
    """Numeric columns of a Hugging Face dataset as numpy views of its Arrow memory: a row is copied when asked for.

    Args:
        hf_dataset: as LeRobot loads it.
    """

    def __init__(self, hf_dataset: Any) -> None:
        table, chosen = hf_dataset.data, hf_dataset._indices
        self._chosen = None if chosen is None else chosen.column(0).to_numpy()
        self._views: dict[str, list[NDArray[Any]]] = {}
        self._starts: dict[str, NDArray[np.int64]] = {}
        for name in hf_dataset.column_names:
            views = [_view(chunk) for chunk in table.column(name).chunks if len(chunk)]
            kept = [view for view in views if view is not None]
            if kept and len(kept) == len(views):
                self._views[name] = kept
                self._starts[name] = np.cumsum([0] + [len(view) for view in kept])

    def __contains__(self, key: str) -> bool:
        """Whether a column is numeric, and so can be read from here."""
        return key in self._views

    def rows(self, key: str, indices: Sequence[int]) -> torch.Tensor:
        """Returns (len(indices), ...) of a column, in the dtypes of LeRobot's own reader: float32, int64 or bool."""
        wanted = np.asarray(indices, dtype=np.int64)
        if self._chosen is not None:
            wanted = self._chosen[wanted]
        starts, views = self._starts[key], self._views[key]
        chunk = np.searchsorted(starts, wanted, side="right") - 1
        picked = np.stack([views[c][row - starts[c]] for c, row in zip(chunk, wanted, strict=True)])
        if picked.dtype == np.bool_:
            return torch.from_numpy(picked)
        return torch.from_numpy(picked.astype(np.float32 if picked.dtype.kind == "f" else np.int64, copy=False))


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))


def _view(chunk: pa.Array) -> NDArray[Any] | None:
    """An Arrow chunk as (rows, ...) numpy; None for text, nulls and ragged lists."""
    shape = [len(chunk)]
    while True:
        if isinstance(chunk, pa.ExtensionArray):
            chunk = chunk.storage
        if chunk.null_count:
            return None
        if not _is_list(chunk.type):
            break
        lengths = pc.unique(pc.list_value_length(chunk))
        if len(lengths) != 1:
            return None
        shape.append(lengths[0].as_py())
        chunk = chunk.flatten()
    kind = chunk.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        return None
    return np.asarray(chunk.to_numpy(zero_copy_only=False)).reshape(shape)


class _Tables:
    """What the fast reader keeps beside a loaded dataset; built on first use in each process."""

    def __init__(self, hf_dataset: Any, episodes: Any) -> None:
        self.source, self.store = hf_dataset, ColumnStore(hf_dataset)
        self.names: list[str] = list(hf_dataset.column_names)
        self._singles: dict[str, Any] = {}
        bounds = zip(
            episodes["episode_index"], episodes["dataset_from_index"], episodes["dataset_to_index"], strict=True
        )
        self.bounds = {int(episode): (int(start), int(end)) for episode, start, end in bounds}

    def single(self, key: str) -> Any:
        """The dataset with just this column: for text and images, which LeRobot's own code converts."""
        if key not in self._singles:
            self._singles[key] = self.source.select_columns([key])
        return self._singles[key]


class FastDatasetReader(DatasetReader):
    """LeRobot's reader, reading numeric columns from Arrow memory, and videos only where somebody looks at them.

    A subclass, not patched methods: data-loading processes unpickle it by name, and so get it too.
    """

    def __getstate__(self) -> dict[str, Any]:
        """Without the views: they are rebuilt from the memory-mapped files in each data-loading process."""
        return {key: value for key, value in self.__dict__.items() if key != "_adamanip_tables"}

    def _tables(self) -> _Tables:
        tables: _Tables | None = self.__dict__.get("_adamanip_tables")
        if tables is None or tables.source is not self.hf_dataset:
            tables = self._adamanip_tables = _Tables(self.hf_dataset, self._meta.episodes)
        return tables

    def _relative(self, indices: Sequence[int]) -> list[int]:
        relative = self._absolute_to_relative_idx
        return list(indices) if relative is None else [relative[index] for index in indices]

    def _get_query_indices(self, abs_idx: int, ep_idx: int) -> tuple[dict[str, list[int]], dict[str, torch.Tensor]]:
        start, end = self._tables().bounds[ep_idx]
        queries: dict[str, list[int]] = {}
        padding: dict[str, torch.Tensor] = {}
        for key, deltas in self.delta_indices.items():
            queries[key] = [max(start, min(end - 1, abs_idx + delta)) for delta in deltas]
            padding[f"{key}_is_pad"] = torch.BoolTensor([not start <= abs_idx + delta < end for delta in deltas])
        return queries, padding

    def _get_query_timestamps(
        self, current_ts: float, query_indices: dict[str, list[int]] | None = None
    ) -> dict[str, list[float]]:
        store, queries = self._tables().store, query_indices or {}
        return {
            key: store.rows("timestamp", self._relative(queries[key])).tolist() if key in queries else [current_ts]
            for key in self._meta.video_keys
        }

    def _query_hf_dataset(self, query_indices: dict[str, list[int]]) -> dict[str, Any]:
        tables = self._tables()
        result: dict[str, Any] = {}
        for key, wanted in query_indices.items():
            if key in tables.store:
                result[key] = tables.store.rows(key, self._relative(wanted))
            elif key not in self._meta.video_keys:
                result[key] = torch.stack(tables.single(key)[self._relative(wanted)][key])
        return result

    def get_item(self, idx: int) -> dict[str, Any]:
        """As LeRobot's own: the row, its windows with their padding, video frames, the task's text."""
        tables = self._tables()
        index = int(idx) + (len(self.hf_dataset) if idx < 0 else 0)
        item: dict[str, Any] = {
            name: tables.store.rows(name, [index])[0] if name in tables.store else tables.single(name)[index][name]
            for name in tables.names
        }
        queries = None
        if self.delta_indices is not None:
            queries, padding = self._get_query_indices(int(item["index"]), int(item["episode_index"]))
            item |= padding
            item |= self._query_hf_dataset(queries)
        if self._meta.video_keys and not getattr(self._meta, _SKIP_VIDEOS, False):
            stamps = self._get_query_timestamps(item["timestamp"].item(), queries)
            item = {**self._query_videos(stamps, int(item["episode_index"])), **item}
        self._convert_images(item)
        item["task"] = self._meta.tasks.iloc[int(item["task_index"])].name
        return item

    def _convert_images(self, item: dict[str, Any]) -> None:
        if self._image_transforms is not None:
            for camera in self._meta.camera_keys:
                if camera in item and camera not in self._meta.depth_keys:
                    item[camera] = self._image_transforms(item[camera])
        for key, unit in getattr(self, _DEPTH_UNITS).items():
            if key in item and unit is not None and unit != self._depth_output_unit:
                item[key] = item[key] * 1000.0 if unit == "m" else item[key] / 1000.0


def version_is_known() -> bool:
    """Whether this LeRobot has the reader that the fix was written for."""
    return str(lerobot.__version__).startswith(FIXED_VERSIONS) and all(hasattr(DatasetReader, n) for n in STOCK_METHODS)


_warned: set[str] = set()


def apply() -> bool:
    """Makes LeRobotDataset use the fast reader, for every policy. Idempotent.

    Returns False, and warns once, for a LeRobot it was not written for.
    """
    if lerobot_dataset.DatasetReader is FastDatasetReader:
        return True
    if not version_is_known():
        version = str(lerobot.__version__)
        if version not in _warned:
            _warned.add(version)
            logging.getLogger(__name__).warning(
                "LeRobot %s is unknown to lerobot_env_adamanip: its own, slower dataset reader stays in place.", version
            )
        return False
    lerobot_dataset.DatasetReader = FastDatasetReader
    return True


def restore() -> None:
    """Puts LeRobot's own reader back: for comparison."""
    lerobot_dataset.DatasetReader = DatasetReader


def skip_videos(dataset_meta: Any) -> None:
    """Marks a dataset as read by a policy that looks at no image.

    The mark is an attribute of the metadata, so it travels with the dataset into data-loading processes.
    """
    setattr(dataset_meta, _SKIP_VIDEOS, True)


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
    """Compares LeRobot's own reader with the fast one on a dataset.

    Args:
        root: folder of the dataset.
        delta_indices: key -> steps relative to the present, as a policy asks for them.
        items: read with each reader, spread over the dataset.
        without_videos: as `dp3_adaptive` reads it; False: as ACT does.

    Returns:
        ``stock_ms`` and ``fast_ms``: mean time of an item [ms]; ``speedup``: their ratio.
    """

    def measured(prepare: Callable[[], object]) -> float:
        prepare()
        plain = lerobot_dataset.LeRobotDataset("local/measured", root=root)
        deltas = {key: [step / plain.meta.fps for step in steps] for key, steps in delta_indices.items()}
        dataset = lerobot_dataset.LeRobotDataset("local/measured", root=root, delta_timestamps=deltas)
        if without_videos:
            skip_videos(dataset.meta)
        dataset[0]
        return item_milliseconds(dataset, np.linspace(0, len(dataset) - 1, items).astype(int).tolist())

    was_fast = lerobot_dataset.DatasetReader is FastDatasetReader
    try:
        stock, fast = measured(restore), measured(apply)
    finally:
        if not was_fast:
            restore()
    return {"stock_ms": stock, "fast_ms": fast, "speedup": stock / fast}


def lazy_async_vector_env(functions: Sequence[Callable[[], Any]]) -> Any:
    """Returns LeRobot's asynchronous vector environment, whose processes start with its first use and end with close.

    So a suite of many tasks holds the processes of one at a time, and an evaluation can be repeated after `close`.
    An ended environment waits until the next rollout (``freeze_after_episode_end``, NEXT_STEP).
    """
    return _LazyAsyncVectorEnv(list(functions))


__all__ = [
    "ColumnStore", "FastDatasetReader", "apply", "freeze_after_episode_end", "item_milliseconds",
    "lazy_async_vector_env", "measure_reader", "restore", "skip_videos", "version_is_known",
]  # fmt: skip
