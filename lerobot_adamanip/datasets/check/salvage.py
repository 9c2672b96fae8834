"""Rows of a Parquet file whose end is missing.

LeRobot's recorder keeps one file open and writes an episode's rows to it when the episode is saved; the footer, without
which nothing can read the file, comes when recording ends. A kill leaves all pages and no footer. The columns are known
from the dataset's description and every page tells its size, so the footer can be written afterwards.
"""

from __future__ import annotations

import copy
import io
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.datasets.check.thrift import I16, I64, LIST, STRUCT, Reader, Struct, Writer

_MAGIC = b"PAR1"
_DATA_PAGE, _DICTIONARY_PAGE, _DATA_PAGE_V2 = 0, 2, 3
_HEADER_BYTES = 1 << 16
"""No page's header is larger (it may hold a smallest and a largest value)."""
_OPTIONAL_OF_CHUNK, _OPTIONAL_OF_META = (4, 5, 6, 7), (8, 12, 13, 14, 15, 16)
"""Fields that tell of statistics and indices, which a salvaged file does without."""


@dataclass(frozen=True)
class _Page:
    """A page: of which kind, how many values, where it begins and ends, and its size with header before compression."""

    kind: int
    values: int
    start: int
    end: int
    plain: int


@dataclass(frozen=True)
class _Template:
    """What LeRobot's writer makes of one row: a footer to copy, and values of each column in a row."""

    footer: Struct
    values: tuple[int, ...]


def salvage(path: Path, features: Mapping[str, Mapping[str, Any]]) -> tuple[bytes, int] | None:
    """Returns a readable Parquet file's content, of the whole row groups in ``path``, and its rows; None without any.

    Args:
        path: of a data file that LeRobot's writer began.
        features: of the dataset, as LeRobot describes them.
    """
    data = path.read_bytes()
    if not data.startswith(_MAGIC):
        return None
    template = _template(features)
    groups = list(_row_groups(data, template))
    while groups:
        content = _finished(data, template, groups)
        readable = _readable_groups(content)
        if readable == len(groups):
            return content, sum(_rows(group, template) for group in groups)
        groups = groups[:readable]
    return None


def _readable_groups(content: bytes) -> int:
    """Returns how many row groups can be read, up to the first that cannot."""
    try:
        file = pq.ParquetFile(io.BytesIO(content))
    except (OSError, pa.ArrowException):
        return 0
    for group in range(file.metadata.num_row_groups):
        try:
            file.read_row_group(group)
        except (OSError, pa.ArrowException):
            return group
    return int(file.metadata.num_row_groups)


def _template(features: Mapping[str, Mapping[str, Any]]) -> _Template:
    import datasets
    from lerobot.datasets.feature_utils import get_hf_features_from_features

    shaped = {key: {**feature, "shape": tuple(feature["shape"])} for key, feature in features.items()}
    columns = get_hf_features_from_features(shaped)
    row = {key: _one_cell(features[key]) for key in columns}
    table = datasets.Dataset.from_dict(row, features=columns).with_format("arrow")[:]
    sink = io.BytesIO()
    with pq.ParquetWriter(sink, schema=table.schema, compression="snappy", use_dictionary=True) as writer:
        writer.write_table(table)
    content = sink.getvalue()
    footer = Reader(content[-8 - int.from_bytes(content[-8:-4], "little") : -8]).struct()
    chunks = footer[4][1][1][0][1][1][1]
    return _Template(footer, tuple(chunk[3][1][5][1] for chunk in chunks))


def _one_cell(feature: Mapping[str, Any]) -> Any:
    shape = tuple(feature["shape"])
    if feature["dtype"] == "string":
        return [""]
    value = np.zeros((1,) if shape == (1,) else (1, *shape), feature["dtype"])
    return value if value.ndim < 3 else list(value)


def _row_groups(data: bytes, template: _Template) -> Iterator[list[list[_Page]]]:
    """Yields the pages of each column of each whole row group."""
    at = len(_MAGIC)
    while True:
        group: list[list[_Page]] = []
        for leaf, per_row in enumerate(template.values):
            rows = (
                sum(page.values for page in group[0] if page.kind != _DICTIONARY_PAGE) // template.values[0]
                if leaf
                else 0
            )
            pages = _column(data, at, rows * per_row if leaf else None)
            if not pages:
                return
            group.append(pages)
            at = pages[-1].end
        yield group


def _column(data: bytes, at: int, wanted: int | None) -> list[_Page]:
    """Returns a column's pages: so many values, or, of the first column, up to the next one's dictionary."""
    pages: list[_Page] = []
    values = 0
    for page in _pages(data, at):
        begins_another = page.kind == _DICTIONARY_PAGE and bool(pages)
        if begins_another or (wanted is not None and values >= wanted):
            break
        pages.append(page)
        values += 0 if page.kind == _DICTIONARY_PAGE else page.values
        if wanted is not None and values >= wanted:
            break
    else:
        return []  # the file ends within the column
    return pages if values and (wanted is None or values == wanted) else []


def _pages(data: bytes, at: int) -> Iterator[_Page]:
    while at < len(data):
        reader = Reader(data[at : at + _HEADER_BYTES])
        try:
            header = reader.struct()
            kind, plain, packed = (int(header[number][1]) for number in (1, 2, 3))
            inner = header[{_DATA_PAGE: 5, _DICTIONARY_PAGE: 7, _DATA_PAGE_V2: 8}[kind]][1]
            values = int(inner[1][1])
        except (ValueError, IndexError, KeyError, TypeError):
            return
        end = at + reader.at + packed
        if packed < 0 or values < 0 or end > len(data):
            return
        yield _Page(kind, values, at, end, reader.at + plain)
        at = end


def _rows(group: list[list[_Page]], template: _Template) -> int:
    return sum(page.values for page in group[0] if page.kind != _DICTIONARY_PAGE) // template.values[0]


def _finished(data: bytes, template: _Template, groups: list[list[list[_Page]]]) -> bytes:
    """Returns the row groups with a footer."""
    footer = copy.deepcopy(template.footer)
    listed = [_group(group, template, number) for number, group in enumerate(groups)]
    footer[3] = (I64, sum(_rows(group, template) for group in groups))
    footer[4] = (LIST, (STRUCT, listed))
    written = bytes(Writer().struct(footer))
    return data[: groups[-1][-1][-1].end] + written + len(written).to_bytes(4, "little") + _MAGIC


def _group(group: list[list[_Page]], template: _Template, number: int) -> Struct:
    made: Struct = copy.deepcopy(template.footer[4][1][1][0])
    chunks = made[1][1][1]
    for chunk, pages in zip(chunks, group, strict=True):
        for unused in _OPTIONAL_OF_CHUNK:
            chunk.pop(unused, None)
        _describe(chunk[3][1], pages)
    packed = [pages[-1].end - pages[0].start for pages in group]
    plain = sum(page.plain for page in itertools.chain.from_iterable(group))
    made[2], made[3] = (I64, plain), (I64, _rows(group, template))
    made[5], made[6], made[7] = (I64, group[0][0].start), (I64, sum(packed)), (I16, number % 2**15)
    return made


def _describe(meta: Struct, pages: list[_Page]) -> None:
    for unused in _OPTIONAL_OF_META:
        meta.pop(unused, None)
    counted = [page for page in pages if page.kind != _DICTIONARY_PAGE]
    meta[5] = (I64, sum(page.values for page in counted))
    meta[6] = (I64, sum(page.plain for page in pages))
    meta[7] = (I64, pages[-1].end - pages[0].start)
    meta[9] = (I64, counted[0].start)
    meta.pop(11, None)
    if len(counted) < len(pages):
        meta[11] = (I64, pages[0].start)
