"""Several datasets in one: LeRobot's aggregation, told of clouds, and statistics as ours have them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip import files
from lerobot_adamanip.demos.loading import load_check
from lerobot_adamanip.demos.statistics import fix_statistics
from lerobot_adamanip.errors import ConfigurationError, DatasetError

_READ = "update_data_df"


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

    names = [f"local/{part.name}" for part in parts]
    with _clouds_readable():
        aggregate_datasets(names, repo_id, roots=list(parts), aggr_root=out)
    fix_statistics(out)


@contextlib.contextmanager
def _clouds_readable() -> Iterator[None]:
    """Inside, LeRobot's aggregation takes columns of two dimensions, which version 0.6.1 reads and cannot write."""
    from lerobot.datasets import aggregate

    plain = getattr(aggregate, _READ, None)
    if plain is None:
        import lerobot

        raise ConfigurationError(
            "This LeRobot merges datasets otherwise.",
            got=f"lerobot {lerobot.__version__}, without {_READ}",
            allowed="lerobot 0.6.1",
            hint="pip install 'lerobot==0.6.1'",
        )

    def update(frame: Any, *arguments: Any) -> Any:
        return plain(type(frame)({name: _lists(frame[name]) for name in frame.columns}), *arguments)

    setattr(aggregate, _READ, update)
    try:
        yield
    finally:
        setattr(aggregate, _READ, plain)


def _lists(column: Any) -> Any:
    """A column of the datasets library's arrays as lists of rows, which pandas and Arrow know; any other as it is."""
    if isinstance(column.dtype, np.dtype):
        return column
    return type(column)([list(cell) for cell in column.array], dtype=object)
