"""LeRobot's deleting, splitting and merging for columns of two dimensions, in the version that it was tested with.

LeRobot 0.6.1 reads such columns as an extension type of the datasets library, which pandas can neither filter nor
write. Here they are read as one array per row, and written with their type, as ``docs/upstream`` proposes for LeRobot
itself: nothing that worked before is done otherwise. Datasets of ours also keep what LeRobot does not know of: their
columns of episodes, statistics in order, cameras, and what tells of their collection.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from lerobot_adamanip import lerobot_version
from lerobot_adamanip.demos.editing.compose import describe
from lerobot_adamanip.demos.editing.source import Source
from lerobot_adamanip.lerobot_compat import is_ours

TESTED = {"0.6.1": "5c929c481edbb396"}
"""LeRobot version -> hash of the source of its editing, for which this was written and tested."""
_log = logging.getLogger(__name__)
_stock: list[tuple[ModuleType, str, Any]] = []
"""What LeRobot had, while it is replaced."""


def is_tested() -> bool:
    """Whether this LeRobot's version, and its editing, are those that this was tested with."""
    return lerobot_version.is_tested(TESTED, _built_on)


def _built_on() -> tuple[ModuleType, ...]:
    from lerobot.datasets import aggregate, dataset_tools

    return aggregate, dataset_tools


def apply() -> bool:
    """Mends LeRobot's editing in this process. Idempotent.

    Returns False, and warns, for a LeRobot it was not tested with, which stays as it is.
    """
    if _stock:
        return True
    if not is_tested():
        _log.warning("LeRobot's editing is not what this was tested with (%s): it stays as it is.", ", ".join(TESTED))
        return False
    from lerobot.datasets import aggregate, dataset_tools

    pandas = _PandasOfArrays(aggregate.pd)
    _replace(aggregate, "pd", pandas)
    _replace(dataset_tools, "pd", pandas)
    _replace(aggregate, "to_parquet_one_row_group_per_episode", write_rows)
    _replace(aggregate, "finalize_aggregation", _then(aggregate.finalize_aggregation, _describe_merged))
    name = "_copy_and_reindex_episodes_metadata"
    _replace(dataset_tools, name, _then(getattr(dataset_tools, name), _describe_chosen))
    return True


def restore() -> None:
    """Puts LeRobot's own editing back."""
    while _stock:
        module, name, value = _stock.pop()
        setattr(module, name, value)


def _replace(module: ModuleType, name: str, value: Any) -> None:
    _stock.append((module, name, getattr(module, name)))
    setattr(module, name, value)


class _PandasOfArrays:
    """pandas, whose `read_parquet` gives columns of two dimensions and more as one array per row."""

    def __init__(self, pandas: Any) -> None:
        self._pandas = pandas

    def __getattr__(self, name: str) -> Any:
        return getattr(self._pandas, name)

    def read_parquet(self, path: str | Path) -> Any:
        """Returns a frame without extension types of the datasets library."""
        from datasets.features.features import PandasArrayExtensionDtype

        frame = self._pandas.read_parquet(path)
        for name, kind in frame.dtypes.items():
            if isinstance(kind, PandasArrayExtensionDtype):
                frame[name] = self._pandas.Series(list(frame[name].array), index=frame.index, dtype=object)
        return frame


def write_rows(frame: Any, path: Path) -> None:
    """Writes rows with one row group per episode, arrays of two dimensions and more with their type.

    Args:
        frame: pandas' frame of rows.
        path: of the file.
    """
    import pyarrow as pa
    from datasets import Dataset, Features
    from lerobot.datasets.io_utils import write_table_one_row_group_per_episode

    kinds = {name: kind for name in frame.columns if (kind := _array_type(frame[name])) is not None}
    table = pa.Table.from_pandas(frame.drop(columns=list(kinds)), preserve_index=False)
    typed = Dataset.from_dict({name: list(frame[name]) for name in kinds}, features=Features(kinds))
    for name, column in zip(kinds, typed.with_format("arrow")[:].columns if kinds else (), strict=True):
        table = table.append_column(pa.field(name, column.type), column)
    write_table_one_row_group_per_episode(table.select(list(frame.columns)), path)


def _array_type(column: Any) -> Any:
    """Returns the datasets library's type for a column of arrays of two dimensions and more; None for any other."""
    import numpy as np
    from datasets import Array2D, Array3D, Array4D, Array5D

    first = column.iloc[0] if column.dtype == object and len(column) else None
    kinds = {2: Array2D, 3: Array3D, 4: Array4D, 5: Array5D}
    if not isinstance(first, np.ndarray) or first.ndim not in kinds or first.dtype == object:
        return None
    return kinds[first.ndim](shape=first.shape, dtype=str(first.dtype))


def _then(stock: Callable[..., Any], more: Callable[..., None]) -> Callable[..., Any]:
    """Returns a function that does what LeRobot's does, and something more afterwards."""

    @functools.wraps(stock)
    def mended(*arguments: Any, **options: Any) -> Any:
        result = stock(*arguments, **options)
        more(*arguments, **options)
        return result

    return mended


def _describe_chosen(
    src_dataset: Any, dst_meta: Any, episode_mapping: Mapping[int, int], *_: object, **__: object
) -> None:
    """After LeRobot wrote the episodes of a part of a dataset."""
    if is_ours(dst_meta.features):
        source = Source.open(Path(src_dataset.root))
        chosen = sorted(episode_mapping, key=episode_mapping.__getitem__)
        describe(
            dst_meta.root,
            [(source, episode) for episode in chosen],
            source.selection.of(chosen, ["lerobot-edit-dataset"]),
        )


def _describe_merged(aggr_meta: Any, all_metadata: list[Any]) -> None:
    """After LeRobot wrote several datasets as one, in their order."""
    if is_ours(aggr_meta.features):
        sources = [Source.open(Path(meta.root)) for meta in all_metadata]
        pieces = [(source, episode) for source in sources for episode in range(source.info["total_episodes"])]
        describe(aggr_meta.root, pieces, None)
