"""Source dataset of copied episodes: metadata and rows of each episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as pads
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.datasets.description import DATA_PATH, TASK, UntrustedValueError, check_episode_text
from lerobot_adamanip.datasets.encoding import PLACE
from lerobot_adamanip.datasets.reading import damaged, episode_table, load_check, untrusted
from lerobot_adamanip.datasets.selection import Selection, read_selection
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import DatasetError

_OF_LEROBOT = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index")
_OF_LEROBOT_PREFIXES = ("stats/", "data/", "videos/", "meta/")


_PLACES = ("episode_index", "length", "dataset_from_index", "dataset_to_index")
_INDEX, _TIME = json_fields.integer(0, 2**40), json_fields.number(0, 1e9)


def _check_place(name: str, value: object) -> None:
    """Raises ValueError for a place of an episode that cannot be, or a text that is not passed on."""
    if name in _PLACES or (name.startswith(("data/", "videos/", "meta/")) and name.endswith("_index")):
        _INDEX(name, value)
    elif name.startswith("videos/"):
        _TIME(name, value)
    else:
        check_episode_text(name, value)


@dataclass(frozen=True)
class Source:
    """Dataset that episodes are copied from.

    Attributes:
        root: its folder.
        info: its ``meta/info.json``, checked.
    """

    root: Path
    info: dict[str, Any]

    @classmethod
    def open(cls, root: Path) -> Source:
        """Opens a dataset of key frames or a robot's recording.

        Raises:
            DatasetError: it is missing, half written or another kind of dataset.
        """
        return cls(root.absolute(), load_check(root, recordings=True))

    @cached_property
    def episodes(self) -> pa.Table:
        """One row per episode, in order, without statistics."""
        return episode_table(self.root).replace_schema_metadata(None)

    @cached_property
    def _statistics(self) -> dict[str, NDArray[Any] | pa.ChunkedArray]:
        """Columns of the episodes' statistics, as arrays where every episode has them."""
        table = episode_table(self.root, statistics=True)
        columns = {name: table[name] for name in table.column_names if name.startswith("stats/")}
        arrays = {name: numeric_array(column) for name, column in columns.items()}
        return {name: column if arrays[name] is None else arrays[name] for name, column in columns.items()}

    @cached_property
    def own_columns(self) -> pa.Table:
        """Columns of `episodes` that are not LeRobot's."""
        names = self.episodes.column_names
        own = [name for name in names if name not in _OF_LEROBOT and not name.startswith(_OF_LEROBOT_PREFIXES)]
        return self.episodes.select(own)

    @cached_property
    def tasks(self) -> list[str]:
        """Task texts by index."""
        table = pq.read_table(self.root / "meta" / "tasks.parquet").sort_by("task_index").to_pandas()
        texts = [str(task) for task in (table["task"] if "task" in table.columns else table.index)]
        try:
            return [TASK("a task", text) for text in texts]
        except ValueError as error:
            raise untrusted(self.root, error) from error

    @cached_property
    def selection(self) -> Selection:
        """Selection that this dataset is; all its own episodes if it is not a part."""
        return read_selection(self.root, self.info["total_episodes"])

    @cached_property
    def _files(self) -> dict[str, pads.Dataset]:
        return {}

    def row(self, episode: int) -> dict[str, Any]:
        """Returns an episode's row of ``meta/episodes``."""
        return self._rows[episode]

    @cached_property
    def _rows(self) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = self.episodes.to_pylist()
        try:
            for row in rows:
                for name, value in row.items():
                    _check_place(name, value)
        except UntrustedValueError as error:
            raise untrusted(self.root, error) from error
        except ValueError as error:
            raise damaged(self.root, f"meta/episodes: {error}") from error
        return rows

    def rows(self, row: Mapping[str, Any]) -> pa.Table:
        """Returns the data rows of an episode, given its `row`; raises `DatasetError` if rows are missing."""
        name = DATA_PATH.format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        wrong: object = f"its rows are not where they should be in {name}"
        try:
            file = self._files[name] = self._files.get(name) or pads.dataset(self.root / name, format="parquet")
            # LeRobot and this project write an episode as one row group, so only that one is read.
            table = file.to_table(filter=pc.field("episode_index") == row["episode_index"])
            if table["index"].to_pylist() == list(range(row["dataset_from_index"], row["dataset_to_index"])):
                return table
        except (OSError, pa.ArrowException) as error:
            wrong = error
        raise DatasetError(
            "Rows of a dataset cannot be read.",
            got=f"{self.root}, episode {row['episode_index']}: {wrong}",
            allowed="consecutive rows of each episode",
            hint=f"adamanip check {self.root.name}",
        )

    def stats(self, episode: int) -> dict[str, dict[str, Any]]:
        """Returns an episode's stored statistics, column -> name -> array."""
        found: dict[str, dict[str, Any]] = {}
        for name, column in self._statistics.items():
            key, _, statistic = name.removeprefix("stats/").rpartition("/")
            one = column[episode : episode + 1]
            values = one if isinstance(one, np.ndarray) else numeric_array(one)
            if values is not None and key not in PLACE:
                found.setdefault(key, {})[statistic] = values[0]
        return found
