"""The only place that touches LeRobot's private names. LeRobot is pinned to 0.6.x, for which this was written.

What is fixed: 0.6.1's dataset reader decodes every column of every row it needs into Python lists, which for point clouds is
what training would wait for; and it decodes videos for policies that look at none. Both are guarded by version.
"""

from __future__ import annotations

import logging
import weakref
from collections.abc import Iterable, Sequence
from typing import Any

import lerobot
import numpy as np
import pyarrow as pa
import torch
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.envs.utils import freeze_after_episode_end
from numpy.typing import NDArray

FIXED_VERSIONS = ("0.6.",)
_SKIP_VIDEOS = "_adamanip_skip_videos"


class ColumnStore:
    """Numeric columns of a Hugging Face dataset as numpy views of its Arrow memory: nothing is copied until a row is asked for.

    Args:
        hf_dataset: as LeRobot loads it.
    """

    def __init__(self, hf_dataset: Any) -> None:
        table = hf_dataset.data
        chosen = hf_dataset._indices
        self._rows = None if chosen is None else chosen.column(0).to_numpy()
        self._views: dict[str, list[NDArray[Any]]] = {}
        self._starts: dict[str, NDArray[np.int64]] = {}
        for name in table.column_names:
            views = [_view(chunk) for chunk in table.column(name).chunks if len(chunk)]
            if views and all(view is not None for view in views):
                kept = [view for view in views if view is not None]
                self._views[name] = kept
                self._starts[name] = np.cumsum([0] + [len(view) for view in kept])

    def __contains__(self, key: str) -> bool:
        """Whether a column is numeric."""
        return key in self._views

    def rows(self, key: str, indices: Sequence[int]) -> torch.Tensor:
        """Returns (len(indices), ...) of a column, in the dtypes of LeRobot's own reader: float32, int64 or bool."""
        wanted = np.asarray(indices, dtype=np.int64)
        if self._rows is not None:
            wanted = self._rows[wanted]
        starts, views = self._starts[key], self._views[key]
        chunk = np.searchsorted(starts, wanted, side="right") - 1
        picked = np.stack([views[c][row - starts[c]] for c, row in zip(chunk, wanted, strict=True)])
        if picked.dtype == np.bool_:
            return torch.from_numpy(picked)
        return torch.from_numpy(picked.astype(np.float32 if picked.dtype.kind == "f" else np.int64, copy=False))


def _view(chunk: pa.Array) -> NDArray[Any] | None:
    """An Arrow chunk as (rows, ...) numpy; None for text, nulls and ragged lists."""
    rows, shape = len(chunk), []
    while True:
        if isinstance(chunk, pa.ExtensionArray):
            chunk = chunk.storage
        if chunk.null_count:
            return None
        if (
            not pa.types.is_list(chunk.type)
            and not pa.types.is_fixed_size_list(chunk.type)
            and not pa.types.is_large_list(chunk.type)
        ):
            break
        inner = chunk.flatten()
        if len(chunk) == 0 or len(inner) % len(chunk):
            return None
        shape.append(len(inner) // len(chunk))
        chunk = inner
    if not (pa.types.is_floating(chunk.type) or pa.types.is_integer(chunk.type) or pa.types.is_boolean(chunk.type)):
        return None
    return np.asarray(chunk.to_numpy(zero_copy_only=False)).reshape(rows, *shape)


class FastDatasetReader(DatasetReader):
    """LeRobot's reader, reading numeric columns from Arrow memory, and videos only where somebody looks at them.

    A subclass, not patched methods: data-loading processes unpickle it by name, and so get it too.
    """

    def _store(self) -> ColumnStore:
        store = _STORES.get(self)
        if store is None or store[0] is not self.hf_dataset:
            store = (self.hf_dataset, ColumnStore(self.hf_dataset))
            _STORES[self] = store
        return store[1]

    def _query_hf_dataset(self, query_indices: dict[str, list[int]]) -> dict[str, Any]:
        store, result, rest = self._store(), {}, {}
        relative = self._absolute_to_relative_idx
        for key, wanted in query_indices.items():
            if key in store:
                result[key] = store.rows(key, wanted if relative is None else [relative[index] for index in wanted])
            else:
                rest[key] = wanted
        return {**result, **super()._query_hf_dataset(rest)}

    def get_item(self, idx: int) -> dict[str, Any]:
        """As LeRobot's, without decoding the row into lists, and without videos that are marked as not needed."""
        store = self._store()
        if not getattr(self._meta, _SKIP_VIDEOS, False) or any(
            name not in store for name in self.hf_dataset.column_names
        ):
            return dict(super().get_item(idx))
        item: dict[str, Any] = {name: store.rows(name, [idx])[0] for name in self.hf_dataset.column_names}
        if self.delta_indices is not None:
            numeric = {key: value for key, value in self.delta_indices.items() if key in store}
            queries, padding = self._get_query_indices(int(item["index"]), int(item["episode_index"]))
            item |= {key: value for key, value in padding.items() if key.removesuffix("_is_pad") in numeric}
            item |= self._query_hf_dataset({key: queries[key] for key in numeric})
        item["task"] = self._meta.tasks.iloc[int(item["task_index"])].name
        return item


_STORES: weakref.WeakKeyDictionary[FastDatasetReader, tuple[Any, ColumnStore]] = weakref.WeakKeyDictionary()
"""Beside the readers, not in them: a reader is pickled into each data-loading process, its views must not be."""


def version_is_known() -> bool:
    """Whether this LeRobot has the reader that the fix was written for."""
    return lerobot.__version__.startswith(FIXED_VERSIONS)


def apply() -> bool:
    """Makes LeRobotDataset use the fast reader. Idempotent. Returns False, and warns, for an unknown LeRobot."""
    if lerobot_dataset.DatasetReader is FastDatasetReader:
        return True
    if not version_is_known():
        logging.getLogger(__name__).warning(
            "LeRobot %s is unknown to lerobot_env_adamanip: its own, slower dataset reader stays in place.",
            lerobot.__version__,
        )
        return False
    lerobot_dataset.DatasetReader = FastDatasetReader  # type: ignore[misc]
    return True


def restore() -> None:
    """Puts LeRobot's own reader back: for comparison."""
    lerobot_dataset.DatasetReader = DatasetReader  # type: ignore[misc]


def skip_videos(dataset_meta: Any) -> None:
    """Marks a dataset as read by a policy that looks at no image. The mark travels with it into data-loading processes."""
    setattr(dataset_meta, _SKIP_VIDEOS, True)


def item_milliseconds(dataset: Any, indices: Iterable[int]) -> float:
    """Returns the mean time of reading an item [ms]."""
    import time

    wanted = list(indices)
    started = time.perf_counter()
    for index in wanted:
        dataset[index]
    return 1e3 * (time.perf_counter() - started) / len(wanted)


__all__ = [
    "ColumnStore", "FastDatasetReader", "apply", "freeze_after_episode_end", "item_milliseconds", "restore", "skip_videos",
    "version_is_known",
]  # fmt: skip
