"""A dataset that episodes are taken from: what is known of each, and its rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.datasets.editing.selection import Selection, read_selection
from lerobot_adamanip.datasets.encoding import PLACE
from lerobot_adamanip.datasets.reading import DATA_PATH, load_check
from lerobot_adamanip.util.errors import DatasetError

_OF_LEROBOT = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index")
_OF_LEROBOT_PREFIXES = ("stats/", "data/", "videos/", "meta/")


@dataclass(frozen=True)
class Source:
    """A dataset to take episodes from.

    Attributes:
        root: its folder.
        info: its ``meta/info.json``, checked.
    """

    root: Path
    info: dict[str, Any]

    @classmethod
    def open(cls, root: Path) -> Source:
        """Returns a dataset of ours, or a robot's recording, checked.

        Raises:
            DatasetError: it is missing, half written or another kind.
        """
        return cls(root.absolute(), load_check(root, recordings=True))

    @cached_property
    def episodes(self) -> pa.Table:
        """One row per episode, statistics included, in order."""
        paths = sorted((self.root / "meta" / "episodes").glob("*/*.parquet"))
        table = pa.concat_tables([pq.read_table(path) for path in paths], promote_options="default")
        return table.sort_by("episode_index").replace_schema_metadata(None)

    @cached_property
    def own_columns(self) -> pa.Table:
        """The columns of `episodes` that LeRobot knows nothing of."""
        names = [
            name
            for name in self.episodes.column_names
            if name not in _OF_LEROBOT and not name.startswith(_OF_LEROBOT_PREFIXES)
        ]
        return self.episodes.select(names)

    @cached_property
    def tasks(self) -> list[str]:
        """Texts of the tasks, by index."""
        table = pq.read_table(self.root / "meta" / "tasks.parquet").sort_by("task_index").to_pandas()
        return [str(task) for task in (table["task"] if "task" in table.columns else table.index)]

    @cached_property
    def selection(self) -> Selection:
        """What the dataset is a part of; of itself, if of no other."""
        return read_selection(self.root, self.info["total_episodes"])

    def row(self, episode: int) -> dict[str, Any]:
        """Returns what ``meta/episodes`` says of an episode."""
        found: dict[str, Any] = self.episodes.slice(episode, 1).to_pylist()[0]
        return found

    def stats(self, episode: int) -> dict[str, dict[str, Any]]:
        """Returns an episode's statistics, column -> name -> array, of the types they are stored with."""
        found: dict[str, dict[str, Any]] = {}
        for name in self.episodes.column_names:
            if name.startswith("stats/"):
                key, _, statistic = name.removeprefix("stats/").rpartition("/")
                column = self.episodes[name]
                kind = column.type
                while pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
                    kind = kind.value_type
                value = np.asarray(column[episode].as_py(), dtype=kind.to_pandas_dtype())
                found.setdefault(key, {})[statistic] = value
        return {key: value for key, value in found.items() if key not in PLACE}


class _RowFile:
    """A file of rows. Holds what it read last: one row group, which is an episode wherever we wrote it."""

    def __init__(self, path: Path) -> None:
        self._file = pq.ParquetFile(path, memory_map=True)
        sizes = [self._file.metadata.row_group(number).num_rows for number in range(self._file.num_row_groups)]
        self._ends = np.cumsum(sizes)
        self._groups, self._table = range(0), pa.table({})
        self.first = int(self._file.read_row_group(0, columns=["index"])["index"][0].as_py())

    def rows(self, begin: int, length: int) -> pa.Table:
        """Returns rows by their place in the file."""
        first, last = np.searchsorted(self._ends, [begin, begin + length - 1], side="right")
        groups = range(int(first), min(int(last) + 1, self._file.num_row_groups))
        if groups != self._groups:
            self._groups, self._table = groups, self._file.read_row_groups(list(groups))
        before = int(self._ends[first - 1]) if first else 0
        return self._table.slice(begin - before, length)


class Rows:
    """Reads the rows of episodes, whatever the order they are asked for in."""

    def __init__(self) -> None:
        self._files: dict[Path, _RowFile] = {}

    def of(self, source: Source, row: Mapping[str, Any]) -> pa.Table:
        """Returns the rows of one episode, as they are stored; raises `DatasetError` if some are missing."""
        place = DATA_PATH.format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        path = source.root / place
        try:
            file = self._files[path] = self._files.get(path) or _RowFile(path)
            rows = file.rows(max(0, row["dataset_from_index"] - file.first), row["length"])
        except (OSError, IndexError, pa.ArrowException) as error:
            raise _damaged(source, row, error) from error
        if set(rows["episode_index"].to_pylist()) != {row["episode_index"]} or len(rows) != row["length"]:
            raise _damaged(source, row, f"its rows are not where they should be in {place}")
        return rows


def _damaged(source: Source, row: Mapping[str, Any], what: object) -> DatasetError:
    return DatasetError(
        "Rows of a dataset cannot be read.",
        got=f"{source.root}, episode {row['episode_index']}: {what}",
        allowed="rows of each episode, one after another",
        hint="adamanip check",
    )
