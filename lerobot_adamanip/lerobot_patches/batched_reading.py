"""Patch: read a batch of rows at once from the training datasets of this project's policies.

Changes:
    Adds ``LeRobotDataset.__getitems__``, which torch's DataLoader calls to get a whole batch. LeRobot does not define
    this method. It affects only datasets whose metadata were marked by `read_in_batches`.
Why:
    LeRobot decodes each row through Python lists: 0.6 ms for a cloud of 1,024 points, 38 ms for a batch of 64. Forward,
    backward and optimizer together take 59 ms. Arrow returns the same batch in 1.1 ms.
Without it:
    The same batches, slower. Videos that these policies do not use are also decoded.
Upstream:
    None filed. LeRobot's readers up to main of 2026-08 read row by row.
Needed for:
    Every LeRobot without its own ``__getitems__``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_adamanip.lerobot_patches import support
from lerobot_adamanip.util.arrow import episode_bounds, numeric_array

LOSS = "Training reads row by row: the same batches, 0.6 ms per row, and unused videos are decoded."
MARK = "_adamanip_read_in_batches"
NARROW_BYTES = 1024
"""Maximum row size of a column that is kept as one tensor."""
Item = dict[str, Any]


class Mark:
    """Mark on a dataset's metadata. Unpickling it in a data-loading worker applies the patch there too."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Recreates the mark when it is unpickled."""
        return _apply, ()


def read_in_batches(dataset_meta: Any) -> None:
    """Applies the patch and marks a dataset's metadata: the policy that reads it uses no images."""
    if not support.are_off(LOSS):
        setattr(dataset_meta, MARK, _apply())


def _apply() -> Mark:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    if not hasattr(LeRobotDataset, "__getitems__"):
        support.replace(LeRobotDataset, "__getitems__", _get_items)
    return Mark()


def _get_items(dataset: Any, indices: Sequence[int]) -> list[Item]:
    """Returns the items of rows like ``dataset[index]``, but without videos."""
    columns = _columns(dataset)
    if columns is None:
        return [dataset[index] for index in indices]
    batch = columns.batch(np.asarray(indices, dtype=np.int64), dataset.reader.delta_indices or {})
    names = dataset.meta.tasks.index
    tasks = [names[task] for task in batch["task_index"].tolist()]
    rows = zip(*(column.unbind() for column in batch.values()), tasks, strict=True)
    return [dict(zip((*batch, "task"), values, strict=True)) for values in rows]


def _columns(dataset: Any) -> _Columns | None:
    """Returns a marked dataset's columns; None if an item needs more than the columns."""
    if not hasattr(dataset.meta, MARK) or dataset.reader is None:
        return None
    source, columns = _known.get(dataset, (None, None))
    if source is not dataset.hf_dataset:
        source = dataset.hf_dataset
        columns = _Columns.of(source.data) if source.data.num_rows == len(source) else None
        _known[dataset] = source, columns
    return columns


class _Columns:
    """Numeric columns of an Arrow table: narrow ones as tensors, wide ones memory-mapped by Arrow.

    Args:
        columns: name -> consecutive arrays (rows, ...).
    """

    def __init__(self, columns: dict[str, list[NDArray[Any]]]) -> None:
        self._arrays = columns
        self._starts = {name: np.cumsum([0, *map(len, arrays)]) for name, arrays in columns.items()}
        self._bounds = episode_bounds(columns["episode_index"][0])

    @classmethod
    def of(cls, table: Any) -> _Columns | None:
        """Returns the columns of a table; None if a column is not numeric and regular, or without rows."""
        columns: dict[str, list[NDArray[Any]]] = {}
        for name in table.column_names:
            arrays = [numeric_array(chunk) for chunk in table.column(name).chunks if len(chunk)]
            known = [array for array in arrays if array is not None]
            if len(known) != len(arrays) or len({array.shape[1:] for array in known}) != 1:
                return None
            columns[name] = known if known[0][0].nbytes > NARROW_BYTES else [np.concatenate(known)]
        return cls(columns)

    def batch(self, rows: NDArray[np.int64], deltas: Mapping[str, Sequence[int]]) -> dict[str, torch.Tensor]:
        """Returns name -> rows (B, ...), or windows (B, T, ...) and padding (B, T), like LeRobot's reader.

        Args:
            rows: (B,) row indices from 0.
            deltas: name -> steps of its window relative to a row.
        """
        batch = {name: self._at(name, rows) for name in self._arrays if name not in deltas}
        for name, steps in deltas.items():
            steps_at = rows[:, None] + np.asarray(steps, dtype=np.int64)
            first, last = (bound[rows, None] for bound in self._bounds)
            batch[f"{name}_is_pad"] = torch.from_numpy((steps_at < first) | (steps_at > last))
            if name in self._arrays:
                values = self._at(name, steps_at.clip(first, last).ravel())
                batch[name] = values.reshape(*steps_at.shape, *values.shape[1:])
        return batch

    def _at(self, name: str, rows: NDArray[np.int64]) -> torch.Tensor:
        """Returns rows (R, ...) of a column in the dtypes of LeRobot's reader: float32, int64 or bool."""
        arrays = self._arrays[name]
        if len(arrays) == 1:
            values = arrays[0][rows]
        else:
            starts = self._starts[name]
            places = np.searchsorted(starts, rows, side="right") - 1
            pairs = zip(places.tolist(), (rows - starts[places]).tolist(), strict=True)
            values = np.stack([arrays[place][row] for place, row in pairs])
        kind = {"f": np.float32, "b": np.bool_}.get(values.dtype.kind, np.int64)
        return torch.from_numpy(values.astype(kind, copy=False))


_known: WeakKeyDictionary[Any, tuple[Any, _Columns | None]] = WeakKeyDictionary()
