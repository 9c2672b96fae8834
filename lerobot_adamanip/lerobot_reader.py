"""A reader of LeRobot datasets that copies numbers out of Arrow memory, and decodes videos only where somebody looks.

LeRobot 0.6.1's own decodes every column of every row it needs into Python lists, and for point clouds training would
wait for that. What this one returns is the same, bit for bit (less the videos nobody looks at). It builds on private
names of LeRobot: `lerobot_adamanip.lerobot_compat` imports it where they are as they were when it was written.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from lerobot.datasets.dataset_reader import DatasetReader

from lerobot_adamanip.columns import ColumnStore
from lerobot_adamanip.lerobot_batches import Batch, Windows, register
from lerobot_adamanip.schema import ACTION, EXECUTED, LATEST_ONLY, SKIP_VIDEOS

_DEPTH_UNITS = "_image_depth_units"


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
        self._asked: dict[str, list[int]] | None = None

    def windows(self, asked: dict[str, list[int]], relative: dict[int, int] | None) -> Windows:
        """What reads batches of windows of these steps; made anew only when other steps are asked for."""
        if asked != self._asked:
            self._asked, self._windows = asked, Windows(self.store, self.names, asked, self.bounds, relative)
        return self._windows

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

    def __setstate__(self, state: dict[str, Any]) -> None:
        """In a data-loading process, which may be a new one: batches are read at once there, too."""
        self.__dict__.update(state)
        register()

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
                past = [place for place, delta in enumerate(self.delta_indices[key]) if delta < 0]
                if key == ACTION and past and EXECUTED in tables.store:
                    sent = self._relative([wanted[place] for place in past])
                    result[key][past] = tables.store.rows(EXECUTED, sent)
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

    def get_batch(self, indices: Sequence[int]) -> Batch | None:
        """Returns what `get_item` gives for each of ``indices``, stacked; None where that has to be done one by one.

        Which is where text, images or videos are to be read.
        """
        tables = self._tables()
        sees = self._meta.video_keys and not getattr(self._meta, SKIP_VIDEOS, False)
        if sees or any(name not in tables.store for name in tables.names):
            return None
        latest, deltas = getattr(self._meta, LATEST_ONLY, ()), self.delta_indices or {}
        asked = {key: steps[-1:] if key in latest else steps for key, steps in deltas.items()}
        batch = tables.windows(asked, self._absolute_to_relative_idx).batch(indices)
        batch["task"] = [self._meta.tasks.iloc[task].name for task in batch["task_index"].tolist()]
        return batch

    def _convert_images(self, item: dict[str, Any]) -> None:
        if self._image_transforms is not None:
            for camera in self._meta.camera_keys:
                if camera in item and camera not in self._meta.depth_keys:
                    item[camera] = self._image_transforms(item[camera])
        for key, unit in getattr(self, _DEPTH_UNITS).items():
            if key in item and unit is not None and unit != self._depth_output_unit:
                item[key] = item[key] * 1000.0 if unit == "m" else item[key] / 1000.0
