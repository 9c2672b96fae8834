"""Numeric columns of a Hugging Face dataset as numpy views of its Arrow memory: read without Python lists."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch
from numpy.typing import NDArray

NARROW_BYTES = 1024
"""Rows up to this size are held in one piece; of larger ones, clouds, the memory-mapped file is all there is."""


class ColumnStore:
    """Numeric columns of a Hugging Face dataset: a row is copied when asked for.

    Clouds stay where Hugging Face keeps them, in a memory-mapped file: once read they are in the memory that the system
    has to spare, once for all processes, and a dataset larger than that is still read. A file comes in pieces of a few
    rows, so narrow columns, some hundred bytes a row, are joined: a batch of windows is then one indexing each.

    Args:
        hf_dataset: as LeRobot loads it.
    """

    def __init__(self, hf_dataset: Any) -> None:
        table, chosen = hf_dataset.data, hf_dataset._indices
        self._chosen = None if chosen is None else chosen.column(0).to_numpy()
        self._views: dict[str, list[NDArray[Any]]] = {}
        self._starts: dict[str, NDArray[np.int64]] = {}
        for name in hf_dataset.column_names:
            views = [numeric_view(chunk) for chunk in table.column(name).chunks if len(chunk)]
            kept = [view for view in views if view is not None]
            if kept and len(kept) == len(views):
                if kept[0][0].nbytes <= NARROW_BYTES:
                    kept = [np.concatenate(kept)]
                self._views[name] = kept
                self._starts[name] = np.cumsum([0] + [len(view) for view in kept])
        self._length = len(hf_dataset)

    def __len__(self) -> int:
        """Rows."""
        return self._length

    def __contains__(self, key: str) -> bool:
        """Whether a column is numeric, and so can be read from here."""
        return key in self._views

    def rows(self, key: str, indices: Sequence[int] | NDArray[np.int64]) -> torch.Tensor:
        """Returns (len(indices), ...) of a column, in the dtypes of LeRobot's own reader: float32, int64 or bool."""
        wanted = np.asarray(indices, dtype=np.int64)
        if self._chosen is not None:
            wanted = self._chosen[wanted]
        starts, views = self._starts[key], self._views[key]
        if len(views) == 1:
            picked = views[0].take(wanted, axis=0)
        else:
            chunk = np.searchsorted(starts, wanted, side="right") - 1
            rows = zip(chunk.tolist(), (wanted - starts[chunk]).tolist(), strict=True)
            picked = np.stack([views[piece][row] for piece, row in rows])
        if picked.dtype == np.bool_:
            return torch.from_numpy(picked)
        return torch.from_numpy(picked.astype(np.float32 if picked.dtype.kind == "f" else np.int64, copy=False))


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))


def numeric_view(chunk: pa.Array) -> NDArray[Any] | None:
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
