"""A reader of LeRobot datasets that copies numbers out of Arrow memory, and decodes videos only where somebody looks.

LeRobot 0.6.1's own decodes every column of every row it needs into Python lists, and for point clouds training would
wait for that. What this one returns is the same, bit for bit (less the videos nobody looks at). It builds on private
names of LeRobot: `lerobot_adamanip.lerobot_compat` imports it where they are as they were when it was written.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch
from lerobot.datasets.dataset_reader import DatasetReader
from numpy.typing import NDArray

from lerobot_adamanip.schema import LATEST_ONLY, SKIP_VIDEOS

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
        for key, asked in self.delta_indices.items():
            deltas = asked[-1:] if key in getattr(self._meta, LATEST_ONLY, ()) else asked
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
        if self._meta.video_keys and not getattr(self._meta, SKIP_VIDEOS, False):
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
