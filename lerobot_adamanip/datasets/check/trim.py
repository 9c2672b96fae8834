"""Cutting off what lies after the last whole episode of a file: rows of a Parquet file, frames of a video."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pyarrow.parquet as pq

from lerobot_adamanip.util import files


def keep_rows(path: Path, rows: int) -> None:
    """Rewrites a data file with its first rows, a row group to each group's: as LeRobot's writer has them."""
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch) / path.name
        source = pq.ParquetFile(path)
        with pq.ParquetWriter(made, source.schema_arrow, compression="snappy", use_dictionary=True) as writer:
            for group in range(source.metadata.num_row_groups):
                size = min(rows, source.metadata.row_group(group).num_rows)
                if size <= 0:
                    break
                writer.write_table(source.read_row_group(group).slice(0, size))
                rows -= size
        files.write_atomically(path, made.read_bytes())


def keep_frames(path: Path, frames: int) -> bool:
    """Rewrites a video with its first frames, as they are coded; whether that could be done.

    Episodes are coded each for itself, so what is cut off begins with a frame that needs none before it.
    """
    import av

    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch) / path.name
        with av.open(str(path)) as source, av.open(str(made), "w") as target:
            stream = source.streams.video[0]
            copy = target.add_stream_from_template(stream)
            rate = float(stream.average_rate or stream.base_rate or 0.0)
            for packet in source.demux(stream):
                if packet.pts is None or packet.time_base is None:
                    continue
                if round(float(packet.pts * packet.time_base) * rate) < frames:
                    packet.stream = copy
                    target.mux(packet)
        with av.open(str(made)) as again:
            left = sum(1 for _ in again.decode(video=0))
        if left != frames:
            return False
        files.write_atomically(path, made.read_bytes())
    return True
