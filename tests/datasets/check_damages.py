"""Ways to damage a dataset, each with what has to be found: a table, and the tools it takes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.video import write_video

DATA = "data/chunk-000/file-000.parquet"
META = "meta/episodes/chunk-000/file-000.parquet"
VIDEO = f"videos/{schema.FRONT_IMAGE}/chunk-000/file-000.mp4"
INFO, STATS, TASKS, ATTEMPTS, COLLECTION, CAMERAS = (
    f"meta/{name}"
    for name in ("info.json", "stats.json", "tasks.parquet", "attempts.jsonl", "collection.json", "cameras.json")
)
OF_LEROBOT = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index")
Place = tuple[str, str | None, int | None, int | None]
"""Kind, file, episode, frame."""


class Damage(NamedTuple):
    name: str
    do: Callable[[Path], object]
    found: Sequence[Place]
    mended: bool = False
    """Whether a repair leaves nothing to be found."""


def cut(name: str, share: float) -> Callable[[Path], object]:
    """A file of which only the first part is there."""

    def do(root: Path) -> object:
        content = (root / name).read_bytes()
        return (root / name).write_bytes(content[: int(share * len(content))])

    return do


def remove(name: str) -> Callable[[Path], object]:
    return lambda root: (root / name).unlink()


def edit_json(name: str, change: Callable[[Any], object]) -> Callable[[Path], object]:
    def do(root: Path) -> object:
        content = json.loads((root / name).read_text())
        change(content)
        return (root / name).write_text(json.dumps(content))

    return do


def write_rows(path: Path, table: pa.Table) -> None:
    """One row group for each episode, as LeRobot's writer has it."""
    episodes = np.asarray(table["episode_index"].to_pylist())
    starts = np.flatnonzero(np.r_[True, np.diff(episodes) != 0]).tolist()
    with pq.ParquetWriter(path, table.schema, compression="snappy") as writer:
        for start, end in zip(starts, [*starts[1:], len(table)], strict=True):
            writer.write_table(table.slice(start, end - start))


def row_of(table: pa.Table, episode: int, frame: int) -> int:
    places = zip(table["episode_index"].to_pylist(), table["frame_index"].to_pylist(), strict=True)
    return next(row for row, place in enumerate(places) if place == (episode, frame))


def edit_rows(change: Callable[[pa.Table], pa.Table]) -> Callable[[Path], object]:
    return lambda root: write_rows(root / DATA, change(pq.read_table(root / DATA)))


def set_column(table: pa.Table, key: str, values: list[Any]) -> pa.Table:
    at = table.schema.get_field_index(key)
    kind = table.schema.field(at).type
    if pa.types.is_fixed_size_list(kind):
        kind = pa.list_(kind.value_type)
    return table.set_column(at, key, pa.array(values, type=kind))


def edit_cell(key: str, episode: int, frame: int, change: Callable[[Any], Any]) -> Callable[[Path], object]:
    """One cell of a data file."""

    def edited(table: pa.Table) -> pa.Table:
        values = table[key].to_pylist()
        row = row_of(table, episode, frame)
        values[row] = change(values[row])
        return set_column(table, key, values)

    return edit_rows(edited)


def at(place: Sequence[int], value: float) -> Callable[[Any], Any]:
    """A nested list with another number at a place."""

    def change(cell: Any) -> Any:
        array = np.array(cell, np.float64)
        array[tuple(place)] = value
        return array.tolist()

    return change


def without_row(episode: int, frame: int) -> Callable[[Path], object]:
    def shorter(table: pa.Table) -> pa.Table:
        row = row_of(table, episode, frame)
        return pa.concat_tables([table.slice(0, row), table.slice(row + 1)])

    return edit_rows(shorter)


def swap_contents(first: int, second: int) -> Callable[[Path], object]:
    """What two episodes of one length hold, exchanged; what says where rows belong stays."""

    def swapped(table: pa.Table) -> pa.Table:
        episodes = np.asarray(table["episode_index"].to_pylist())
        one, other = (np.flatnonzero(episodes == number) for number in (first, second))
        assert len(one) == len(other)
        order = np.arange(len(table))
        order[one], order[other] = other, one
        for key in table.column_names:
            if key not in ("index", "episode_index", "frame_index", "timestamp", "task_index"):
                values = table[key].to_pylist()
                table = set_column(table, key, [values[row] for row in order])
        return table

    return edit_rows(swapped)


def edit_episode(episode: int, **values: Any) -> Callable[[Path], object]:
    """Columns of an episode's metadata."""

    def do(root: Path) -> object:
        table = pq.read_table(root / META)
        for key, value in values.items():
            column = table[key].to_pylist()
            column[episode] = value(column[episode]) if callable(value) else value
            field = table.schema.field(key)
            table = table.set_column(table.schema.get_field_index(key), field, pa.array(column, field.type))
        return pq.write_table(table, root / META)

    return do


def without_metadata(episodes: int) -> Callable[[Path], object]:
    """Metadata of the first episodes alone."""

    def do(root: Path) -> object:
        return pq.write_table(pq.read_table(root / META).slice(0, episodes), root / META)

    return do


def break_pages(episode: int) -> Callable[[Path], object]:
    """Bytes of an episode's cloud, overwritten."""

    def do(root: Path) -> object:
        content = bytearray((root / DATA).read_bytes())
        chunk = pq.ParquetFile(root / DATA).metadata.row_group(episode).column(0)
        start = chunk.dictionary_page_offset or chunk.data_page_offset
        content[start : start + chunk.total_compressed_size] = b"\xff" * chunk.total_compressed_size
        return (root / DATA).write_bytes(content)

    return do


def film(root: Path, lengths: Sequence[int], change: Callable[[list[Any]], list[Any]]) -> None:
    """Codes the dataset's video again after a change of its frames."""
    import av

    with av.open(str(root / VIDEO)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == sum(lengths)
    write_video(root / VIDEO, change(frames), schema.FPS)


def lengths_of(root: Path) -> list[int]:
    return [int(value) for value in pq.read_table(root / META)["length"].to_pylist()]


def edit_film(change: Callable[[list[Any]], list[Any]]) -> Callable[[Path], object]:
    return lambda root: film(root, lengths_of(root), change)


def drop_line(root: Path) -> object:
    lines = (root / ATTEMPTS).read_text().splitlines(keepends=True)
    return (root / ATTEMPTS).write_text("".join(lines[:-1]))


def leave(name: str) -> Callable[[Path], object]:
    def do(root: Path) -> object:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        return (root / name).write_bytes(b"half")

    return do


def copy_data(root: Path) -> object:
    return shutil.copy(root / DATA, root / "data/chunk-000/file-001.parquet")


def other_record(value: str) -> str:
    return json.dumps({**json.loads(value), "seed": 1})


def of_another(stats: dict[str, Any]) -> None:
    for name, values in stats["action"].items():
        stats["action"][name] = values if name == "count" else [value + 0.3 for value in values]


def more(values: list[float]) -> list[float]:
    return [value + 0.1 for value in values]
