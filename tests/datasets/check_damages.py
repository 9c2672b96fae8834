"""Ways to damage a dataset, each with what has to be found: a table, and the tools it takes."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.utils.io_utils import write_video

from lerobot_adamanip.contract import schema

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


def damage(work: Callable[..., object]) -> Callable[..., Callable[[Path], object]]:
    """Makes a function of a dataset's root, and of more, one of the others that waits for the root."""
    return lambda *options, **named: lambda root: work(root, *options, **named)


@damage
def cut(root: Path, name: str, share: float) -> None:
    """Leaves the first part of a file."""
    content = (root / name).read_bytes()
    (root / name).write_bytes(content[: int(share * len(content))])


@damage
def remove(root: Path, name: str) -> None:
    (root / name).unlink()


@damage
def leave(root: Path, name: str) -> None:
    """Adds what a killed process leaves."""
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_bytes(b"half")


@damage
def edit_json(root: Path, name: str, change: Callable[[Any], object]) -> None:
    content = json.loads((root / name).read_text())
    change(content)
    (root / name).write_text(json.dumps(content))


def edit_rows(root: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    """Writes changed rows: one row group for each episode, as LeRobot's writer has it."""
    table = change(pq.read_table(root / DATA))
    episodes = np.asarray(table["episode_index"].to_pylist())
    starts = np.flatnonzero(np.r_[True, np.diff(episodes) != 0]).tolist()
    with pq.ParquetWriter(root / DATA, table.schema, compression="snappy") as writer:
        for start, end in itertools.pairwise([*starts, len(table)]):
            writer.write_table(table.slice(start, end - start))


def row_of(table: pa.Table, episode: int, frame: int) -> int:
    places = zip(table["episode_index"].to_pylist(), table["frame_index"].to_pylist(), strict=True)
    return list(places).index((episode, frame))


def set_column(table: pa.Table, key: str, values: list[Any]) -> pa.Table:
    at = table.schema.get_field_index(key)
    kind = table.schema.field(at).type
    if pa.types.is_fixed_size_list(kind):
        kind = pa.list_(kind.value_type)
    return table.set_column(at, key, pa.array(values, type=kind))


@damage
def edit_cell(root: Path, key: str, episode: int, frame: int, change: Callable[[Any], Any]) -> None:
    def edited(table: pa.Table) -> pa.Table:
        values = table[key].to_pylist()
        row = row_of(table, episode, frame)
        values[row] = change(values[row])
        return set_column(table, key, values)

    edit_rows(root, edited)


def at(place: Sequence[int], value: float) -> Callable[[Any], Any]:
    """A nested list with another number at a place."""

    def change(cell: Any) -> Any:
        array = np.array(cell, np.float64)
        array[tuple(place)] = value
        return array.tolist()

    return change


@damage
def without_row(root: Path, episode: int, frame: int) -> None:
    def shorter(table: pa.Table) -> pa.Table:
        row = row_of(table, episode, frame)
        return pa.concat_tables([table.slice(0, row), table.slice(row + 1)])

    edit_rows(root, shorter)


@damage
def swap_contents(root: Path, first: int, second: int) -> None:
    """Exchanges what two episodes of one length hold; what says where rows belong stays."""

    def swapped(table: pa.Table) -> pa.Table:
        episodes = np.asarray(table["episode_index"].to_pylist())
        one, other = (np.flatnonzero(episodes == number) for number in (first, second))
        order = np.arange(len(table))
        order[one], order[other] = other, one
        for key in table.column_names:
            if key not in ("index", "episode_index", "frame_index", "timestamp", "task_index"):
                values = table[key].to_pylist()
                table = set_column(table, key, [values[row] for row in order])
        return table

    edit_rows(root, swapped)


@damage
def edit_episode(root: Path, episode: int, **values: Any) -> None:
    """Changes columns of an episode's metadata."""
    table = pq.read_table(root / META)
    for key, value in values.items():
        column = table[key].to_pylist()
        column[episode] = value(column[episode]) if callable(value) else value
        field = table.schema.field(key)
        table = table.set_column(table.schema.get_field_index(key), field, pa.array(column, field.type))
    pq.write_table(table, root / META)


@damage
def without_metadata(root: Path, episodes: int) -> None:
    """Leaves the metadata of the first episodes alone."""
    pq.write_table(pq.read_table(root / META).slice(0, episodes), root / META)


@damage
def break_pages(root: Path, episode: int) -> None:
    """Overwrites the bytes of an episode's cloud."""
    content = bytearray((root / DATA).read_bytes())
    chunk = pq.ParquetFile(root / DATA).metadata.row_group(episode).column(0)
    start = chunk.dictionary_page_offset or chunk.data_page_offset
    content[start : start + chunk.total_compressed_size] = b"\xff" * chunk.total_compressed_size
    (root / DATA).write_bytes(content)


@damage
def edit_film(root: Path, change: Callable[[list[Any]], list[Any]]) -> None:
    """Codes the dataset's video again after a change of its frames."""
    import av

    with av.open(str(root / VIDEO)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    write_video(root / VIDEO, change(frames), schema.FPS)


def drop_line(root: Path) -> None:
    lines = (root / ATTEMPTS).read_text().splitlines(keepends=True)
    (root / ATTEMPTS).write_text("".join(lines[:-1]))


def copy_data(root: Path) -> None:
    shutil.copy(root / DATA, root / "data/chunk-000/file-001.parquet")


def other_record(value: str) -> str:
    return json.dumps({**json.loads(value), "seed": 1})


def of_another(stats: dict[str, Any]) -> None:
    for name, values in stats["action"].items():
        stats["action"][name] = values if name == "count" else [value + 0.3 for value in values]


def more(values: list[float]) -> list[float]:
    return [value + 0.1 for value in values]
