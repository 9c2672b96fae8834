"""Stores clouds (N, 3) of datasets of version 0.2 as rows of 3 N numbers, which LeRobot's tools can edit."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_adamanip.datasets.check.contract import is_old_cloud
from lerobot_adamanip.datasets.check.layout import INFO, STATS
from lerobot_adamanip.datasets.check.reading import numeric
from lerobot_adamanip.datasets.editing.compose import arrow_schema, with_types
from lerobot_adamanip.datasets.reading import MAX_STATISTICS_BYTES, read_info
from lerobot_adamanip.datasets.statistics import cloud_statistics, write_episodes
from lerobot_adamanip.util import files
from lerobot_adamanip.util.json_fields import read

_STATS = f"stats/{POINT_CLOUD}/"


def flatten_clouds(root: Path, keep: Callable[[str], None]) -> bool:
    """Stores the clouds of a dataset as rows of 3 N numbers, and says so in its metadata. Values stay.

    ``meta/info.json`` comes last: what was interrupted is finished the next time.

    Args:
        root: of a dataset whose files can be read.
        keep: told of each file before it is changed, path within the dataset.

    Returns:
        Whether there were any to store otherwise.
    """
    from lerobot.datasets.compute_stats import aggregate_stats

    info = read_info(root)
    feature = info["features"].get(POINT_CLOUD, {})
    if not is_old_cloud(POINT_CLOUD, feature):
        return False
    feature["shape"] = [int(np.prod(feature["shape"]))]
    names = [path.relative_to(root).as_posix() for path in sorted(root.glob("**/*.parquet"))]
    schema = arrow_schema({key: {**each, "shape": tuple(each["shape"])} for key, each in info["features"].items()})
    for name in (*names, STATS, INFO):
        keep(name)
    found: dict[int, dict[str, NDArray[Any]]] = {}
    for name in names:  # data come first
        if name.startswith("data/"):
            _flatten_rows(root / name, schema)
            found |= _statistics(root / name)
        elif name.startswith("meta/episodes/"):
            _replace_statistics(root / name, found)
    stats = read(root / STATS, max_bytes=MAX_STATISTICS_BYTES)
    whole = aggregate_stats([{POINT_CLOUD: each} for each in found.values()])[POINT_CLOUD]
    stats[POINT_CLOUD] = {key: value.tolist() for key, value in whole.items()}
    for name, content in ((STATS, stats), (INFO, info)):
        files.write_atomically(root / name, (json.dumps(content, indent=4) + "\n").encode())
    return True


def _flatten_rows(path: Path, schema: pa.Schema) -> None:
    """Rewrites a data file, a row group to each of its row groups."""
    source, sink = pq.ParquetFile(path), io.BytesIO()
    with pq.ParquetWriter(sink, schema, compression="snappy", use_dictionary=True) as writer:
        for group in range(source.num_row_groups):
            table = source.read_row_group(group)
            clouds = numeric(table, POINT_CLOUD)
            if clouds is None:
                raise ValueError(f"{path.name} has clouds of different sizes")
            at = table.schema.get_field_index(POINT_CLOUD)
            field = schema.field(POINT_CLOUD)
            flat = pa.FixedSizeListArray.from_arrays(pa.array(clouds.reshape(-1)), field.type.list_size)
            writer.write_table(with_types(table.set_column(at, field, flat.cast(field.type)), schema))
    files.write_atomically(path, sink.getvalue())


def _statistics(path: Path) -> dict[int, dict[str, NDArray[Any]]]:
    """Statistics of the clouds of each episode in a data file."""
    table = pq.read_table(path, columns=[POINT_CLOUD, "episode_index"])
    clouds, episodes = numeric(table, POINT_CLOUD), table["episode_index"].to_numpy()
    if clouds is None:
        raise ValueError(f"{path.name} has clouds of different sizes")
    return {int(number): cloud_statistics(clouds[episodes == number]) for number in np.unique(episodes)}


def _replace_statistics(path: Path, found: dict[int, dict[str, NDArray[Any]]]) -> None:
    table = pq.read_table(path)
    numbers = table["episode_index"].to_pylist()
    for at, name in enumerate(table.column_names):
        if name.startswith(_STATS):
            values = [found[number][name.removeprefix(_STATS)] for number in numbers]
            table = table.set_column(at, name, pa.array(list(values)))
    write_episodes(path, table)
