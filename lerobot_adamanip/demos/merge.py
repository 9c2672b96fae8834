"""Several datasets in one: LeRobot's aggregation, with a writer that knows clouds, and statistics as ours have them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip import files, schema
from lerobot_adamanip.demos.loading import load_check
from lerobot_adamanip.errors import ConfigurationError, DatasetError

_WRITER = "to_parquet_one_row_group_per_episode"


def merge(roots: Sequence[Path], out: Path, *, repo_id: str | None = None) -> int:
    """Writes one dataset with the episodes of several, in their order; returns their number.

    Rows and the columns of episodes stay as they are; tasks, indices and statistics are those of the whole. Half of a
    dataset is never at ``out``. What tells of one collection alone (its manifest, its attempts) is not merged, so
    `adamanip replay` wants the parts.

    Args:
        roots: of datasets with equal features; two or more.
        out: of the new one; a folder that does not exist.
        repo_id: ``local/<folder name>`` by default.

    Raises:
        DatasetError: a part is missing, half written or of other features, or something is at ``out``.
        ConfigurationError: fewer than two parts, or this LeRobot writes datasets otherwise.
    """
    parts, out = [root.absolute() for root in roots], out.absolute()
    _require_mergeable(parts, out)
    half = out.with_name(out.name + ".merging")
    files.remove_tree(half)
    half.parent.mkdir(parents=True, exist_ok=True)
    _aggregate(parts, half, repo_id or f"local/{out.name}")
    episodes = int(load_check(half)["total_episodes"])
    files.move_durably(half, out)
    return episodes


def _require_mergeable(parts: Sequence[Path], out: Path) -> None:
    if len(parts) < 2:
        raise ConfigurationError(
            "There is nothing to merge.",
            got=f"{len(parts)} dataset(s)",
            allowed="two or more",
            hint="adamanip merge ONE OTHER --out BOTH",
        )
    if out.exists():
        raise DatasetError(
            "There is something where the new dataset is to be.",
            got=out,
            allowed="a folder that does not exist",
            hint="another --out",
        )
    first, *others = (_features(load_check(part)) for part in parts)
    for part, features in zip(parts[1:], others, strict=True):
        if differing := sorted(key for key in {**first, **features} if first.get(key) != features.get(key)):
            raise DatasetError(
                "Datasets of different features cannot be one.",
                got=f"{part.name} has {', '.join(differing[:3])} otherwise than {parts[0].name}",
                allowed="the same columns, of the same shapes",
                hint="the same --num-points, and pictures in all of them or in none",
            )


def _features(info: dict[str, Any]) -> dict[str, Any]:
    """Features by kind and shape; what a video's file says of itself may differ."""
    return {key: (feature["dtype"], tuple(feature["shape"])) for key, feature in info["features"].items()}


def _aggregate(parts: Sequence[Path], out: Path, repo_id: str) -> None:
    from lerobot.datasets.aggregate import aggregate_datasets
    from lerobot.datasets.io_utils import load_stats, write_stats

    names = [f"local/{part.name}" for part in parts]
    with _clouds_written():
        aggregate_datasets(names, repo_id, roots=list(parts), aggr_root=out)
    write_stats(dict(sorted(schema.fix_pose_statistics(load_stats(out)).items())), out)


@contextlib.contextmanager
def _clouds_written() -> Iterator[None]:
    """Inside, LeRobot's aggregation writes columns of two dimensions, which its own writer (0.6.1) stumbles over."""
    from lerobot.datasets import aggregate

    plain = getattr(aggregate, _WRITER, None)
    if plain is None:
        import lerobot

        raise ConfigurationError(
            "This LeRobot writes datasets otherwise.",
            got=f"lerobot {lerobot.__version__}, without {_WRITER}",
            allowed="lerobot 0.6.1",
            hint="pip install 'lerobot==0.6.1'",
        )

    read = aggregate.update_data_df

    def plainly(frame: Any, *arguments: Any) -> Any:
        # The datasets library's type of arrays is not one that pandas can compare or concatenate.
        columns = {name: _objects(frame[name]) for name in frame.columns}
        return read(type(frame)(columns), *arguments)

    def write(frame: Any, path: Path) -> None:
        from lerobot.datasets.io_utils import write_table_one_row_group_per_episode

        flat = [name for name in frame.columns if not _is_nested(frame[name])]
        table = pa.Table.from_pandas(frame[flat], preserve_index=False)
        for place, name in enumerate(frame.columns):
            if name not in flat:
                table = table.add_column(place, name, _nested(np.stack([np.stack(cell) for cell in frame[name]])))
        write_table_one_row_group_per_episode(table, path)

    setattr(aggregate, _WRITER, write)
    aggregate.update_data_df = plainly
    try:
        yield
    finally:
        setattr(aggregate, _WRITER, plain)
        aggregate.update_data_df = read


def _objects(column: Any) -> Any:
    """A column of numpy's types as it is, any other as objects."""
    return column if isinstance(column.dtype, np.dtype) else type(column)(list(column.array), dtype=object)


def _is_nested(column: Any) -> bool:
    first = column.iloc[0] if len(column) else None
    return isinstance(first, np.ndarray) and (first.ndim > 1 or first.dtype == object)


def _nested(values: NDArray[Any]) -> pa.Array:
    """(R, N, D) -> a column of R lists of N lists of D."""
    rows, points, numbers = values.shape
    inner = pa.ListArray.from_arrays(
        np.arange(0, rows * points + 1, dtype=np.int32) * numbers, pa.array(values.ravel())
    )
    return pa.ListArray.from_arrays(np.arange(rows + 1, dtype=np.int32) * points, inner)
