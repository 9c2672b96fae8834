"""A dataset to copy episodes from: its metadata by episode, and the rows of each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_adamanip.datasets.encoding import PLACE
from lerobot_adamanip.datasets.reading import DATA_PATH, load_check
from lerobot_adamanip.datasets.selection import Selection, read_selection
from lerobot_adamanip.datasets.statistics import cloud_statistics
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import DatasetError

_OF_LEROBOT = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index")
_OF_LEROBOT_PREFIXES = ("stats/", "data/", "videos/", "meta/")


@dataclass(frozen=True)
class Source:
    """A dataset to copy episodes from.

    Attributes:
        root: its folder.
        info: its ``meta/info.json``, checked; clouds of version 0.2, (N, 3), appear as (3 N,).
    """

    root: Path
    info: dict[str, Any]

    @classmethod
    def open(cls, root: Path) -> Source:
        """Opens a dataset of key frames or a robot's recording.

        Raises:
            DatasetError: it is missing, half written or of another kind.
        """
        info = load_check(root, recordings=True, old_clouds=True)
        if POINT_CLOUD in info["features"]:
            info["features"][POINT_CLOUD]["shape"] = [math.prod(info["features"][POINT_CLOUD]["shape"])]
        return cls(root.absolute(), info)

    @cached_property
    def episodes(self) -> pa.Table:
        """One row per episode, statistics included, in order."""
        paths = sorted((self.root / "meta" / "episodes").glob("*/*.parquet"))
        table = pa.concat_tables([pq.read_table(path) for path in paths], promote_options="default")
        return table.sort_by("episode_index").replace_schema_metadata(None)

    @cached_property
    def own_columns(self) -> pa.Table:
        """The columns of `episodes` that are not LeRobot's."""
        names = self.episodes.column_names
        own = [name for name in names if name not in _OF_LEROBOT and not name.startswith(_OF_LEROBOT_PREFIXES)]
        return self.episodes.select(own)

    @cached_property
    def tasks(self) -> list[str]:
        """Task texts by index."""
        table = pq.read_table(self.root / "meta" / "tasks.parquet").sort_by("task_index").to_pandas()
        return [str(task) for task in (table["task"] if "task" in table.columns else table.index)]

    @cached_property
    def selection(self) -> Selection:
        """The dataset that this one is a part of, itself if of no other."""
        return read_selection(self.root, self.info["total_episodes"])

    @cached_property
    def _files(self) -> dict[str, _RowFile]:
        return {}

    def row(self, episode: int) -> dict[str, Any]:
        """Returns an episode's row of ``meta/episodes``."""
        found: dict[str, Any] = self.episodes.slice(episode, 1).to_pylist()[0]
        return found

    def rows(self, row: Mapping[str, Any]) -> pa.Table:
        """Returns the data rows of an episode.

        Args:
            row: of the episode, see `row`.

        Raises:
            DatasetError: some of them are missing.
        """
        name = DATA_PATH.format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"])
        try:
            file = self._files[name] = self._files.get(name) or _RowFile(self.root / name)
            table = file.rows(max(0, row["dataset_from_index"] - file.first), row["length"])
        except (OSError, IndexError, pa.ArrowException) as error:
            raise self._damaged(row, error) from error
        if set(table["episode_index"].to_pylist()) != {row["episode_index"]} or len(table) != row["length"]:
            raise self._damaged(row, f"its rows are not where they should be in {name}")
        return _flat_clouds(table)

    def stats(self, episode: int, rows: pa.Table) -> dict[str, dict[str, Any]]:
        """Returns an episode's stored statistics, column -> name -> array.

        Args:
            episode: its index.
            rows: of the episode; clouds of version 0.2 get their statistics from these.
        """
        found: dict[str, dict[str, Any]] = {}
        for name in self.episodes.column_names:
            if name.startswith("stats/"):
                key, _, statistic = name.removeprefix("stats/").rpartition("/")
                column = self.episodes[name]
                value = np.asarray(column[episode].as_py(), dtype=_number_type(column.type))
                found.setdefault(key, {})[statistic] = value
        if (
            POINT_CLOUD in found
            and list(found[POINT_CLOUD]["min"].shape) != self.info["features"][POINT_CLOUD]["shape"]
        ):
            found[POINT_CLOUD] = cloud_statistics(_clouds(rows))
        return {key: value for key, value in found.items() if key not in PLACE}

    def _damaged(self, row: Mapping[str, Any], what: object) -> DatasetError:
        return DatasetError(
            "Rows of a dataset cannot be read.",
            got=f"{self.root}, episode {row['episode_index']}: {what}",
            allowed="rows of each episode, one after another",
            hint=f"adamanip check {self.root.name}",
        )


class _RowFile:
    """An open data file and its latest row groups: an episode is one group wherever LeRobot or we wrote it."""

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


def _number_type(kind: pa.DataType) -> Any:
    while pa.types.is_nested(kind):
        kind = kind.value_type
    return kind.to_pandas_dtype()


def _clouds(rows: pa.Table) -> Any:
    clouds = numeric_array(rows[POINT_CLOUD])
    if clouds is None:
        raise ValueError("clouds of different sizes")
    return clouds.reshape(len(rows), -1)


def _flat_clouds(rows: pa.Table) -> pa.Table:
    """Returns rows with clouds (3 N,), where version 0.2 stored (N, 3)."""
    at = rows.schema.get_field_index(POINT_CLOUD)
    if at < 0 or not isinstance(rows.schema.field(at).type, pa.ExtensionType):
        return rows
    clouds = _clouds(rows)
    return rows.set_column(at, POINT_CLOUD, pa.FixedSizeListArray.from_arrays(clouds.ravel(), clouds.shape[1]))
