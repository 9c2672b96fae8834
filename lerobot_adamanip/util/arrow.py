"""Conversion of Arrow columns to numpy arrays without Python lists."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray


def numeric_array(column: pa.Array | pa.ChunkedArray) -> NDArray[Any] | None:
    """Returns a column as a (rows, ...) numpy array; None for text, nulls and ragged lists."""
    chunk = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
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


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))


def episode_bounds(episode: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the first and the last row (R,) of each row's episode; rows must be ordered by ``episode`` (R,)."""
    starts = np.flatnonzero(np.diff(episode, prepend=-1))
    ends = np.append(starts[1:], len(episode))
    lengths = ends - starts
    return np.repeat(starts, lengths), np.repeat(ends - 1, lengths)
