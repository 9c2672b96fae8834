"""Whole batches of windows by indexing, handed to torch's DataLoader as a list of items that is collated already."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, overload

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from numpy.typing import NDArray
from torch.utils.data import default_collate
from torch.utils.data._utils.collate import default_collate_fn_map

from lerobot_adamanip.columns import ColumnStore
from lerobot_adamanip.schema import ACTION, EXECUTED

Batch = dict[str, Any]
"""Key -> tensor (B, ...), or a list of B texts."""


class Windows:
    """Rows of a dataset with their windows, for many rows at once.

    Args:
        store: of the dataset's columns, all numeric.
        names: of the columns, in the order that items have.
        deltas: key -> steps relative to a row that its window holds.
        bounds: episode -> its first row and the row after its last, in the whole dataset.
        relative: row in the whole dataset -> row in the store; None if they are the same.
    """

    def __init__(
        self,
        store: ColumnStore,
        names: Sequence[str],
        deltas: Mapping[str, Sequence[int]],
        bounds: Mapping[int, tuple[int, int]],
        relative: Mapping[int, int] | None,
    ) -> None:
        self._store, self._names = store, names
        self._deltas = {key: np.asarray(steps, dtype=np.int64) for key, steps in deltas.items()}
        self._bounds = np.zeros((1 + max(bounds, default=0), 2), dtype=np.int64)
        for episode, bound in bounds.items():
            self._bounds[episode] = bound
        self._relative: NDArray[np.int64] | None = None
        if relative is not None:
            self._relative = np.full(1 + max(relative, default=0), -1, dtype=np.int64)
            self._relative[list(relative)] = list(relative.values())
        self._length = len(store)

    def batch(self, indices: Sequence[int]) -> Batch:
        """Returns rows (B, ...), windows (B, T, ...) and their padding (B, T), in the order of an item's keys.

        Past actions are those that were executed: where a policy drove, the column ``action`` tells what to do better.

        Args:
            indices: rows of the store; negative ones count from its end.

        Raises:
            IndexError: there is no such row.
        """
        rows = np.asarray(indices, dtype=np.int64)
        rows = np.where(rows < 0, rows + self._length, rows)
        if ((rows < 0) | (rows >= self._length)).any():
            raise IndexError(f"rows {list(indices)} of a dataset of {self._length}")
        index, episode = (self._store.rows(name, rows).numpy() for name in ("index", "episode_index"))
        start, end = (bound[:, None] for bound in self._bounds[episode].T)
        batch: Batch = {name: self._store.rows(name, rows) for name in self._names if name not in self._deltas}
        windows: Batch = {}
        for key, steps in self._deltas.items():
            wanted = index[:, None] + steps
            batch[f"{key}_is_pad"] = torch.from_numpy((wanted < start) | (wanted >= end))
            if key in self._store:
                found = wanted.clip(start, end - 1)
                windows[key] = self._window(key, found)
                if key == ACTION and EXECUTED in self._store and (past := steps < 0).any():
                    windows[key][:, past] = self._window(EXECUTED, found[:, past])
        return {**{name: windows.get(name, batch.get(name)) for name in self._names}, **batch, **windows}

    def _window(self, key: str, wanted: NDArray[np.int64]) -> torch.Tensor:
        rows = wanted if self._relative is None else self._relative[wanted]
        found = self._store.rows(key, rows.ravel())
        return found.reshape(*rows.shape, *found.shape[1:])


class Item(dict[str, Any]):
    """A dataset's item that came as a part of a batch."""


class CollatedItems(Sequence[Item]):
    """A batch that also is the list of its items, for a ``collate_fn`` that wants to see them.

    Args:
        columns: of the batch, each of the same length.
        length: of the batch.
    """

    def __init__(self, columns: Batch, length: int) -> None:
        self.columns, self._length = columns, length

    def __len__(self) -> int:
        """Items."""
        return self._length

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        """The item at a place of the batch, as views of the batch."""
        if isinstance(index, slice):
            return [self[place] for place in range(*index.indices(self._length))]
        if not -self._length <= index < self._length:
            raise IndexError(index)
        return Item({key: column[index] for key, column in self.columns.items()})

    def __iter__(self) -> Iterator[Item]:
        """Items in order."""
        return (self[place] for place in range(self._length))


def _collate(items: Sequence[Item], **_: Any) -> Any:
    """What is collated already is passed on; single items are collated as any others."""
    return items.columns if isinstance(items, CollatedItems) else default_collate([dict(item) for item in items])


def _get_items(dataset: Any, indices: Sequence[int]) -> Sequence[dict[str, Any]]:
    """What torch's DataLoader asks a dataset for, if it can: many items at once."""
    reader = dataset.reader
    loaded = hasattr(reader, "get_batch") and reader.hf_dataset is not None and dataset.writer is None
    batch = reader.get_batch(indices) if loaded else None
    return [dataset[index] for index in indices] if batch is None else CollatedItems(batch, len(indices))


def register() -> None:
    """Lets DataLoaders ask LeRobot's datasets for batches, and torch's `default_collate` know those of this project.

    The latter in the way that torch documents for types of one's own.
    """
    default_collate_fn_map[Item] = _collate
    LeRobotDataset.__getitems__ = _get_items
