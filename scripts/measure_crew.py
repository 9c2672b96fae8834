"""What a Ray crew costs against the pool of processes: items of a second, results of the size of an episode, written.

    python scripts/measure_crew.py --workers 2 --items 30 --repeats 5

Prints JSON: the time from the first result to the last, per item, of both in turn, and by how much one is longer.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from lerobot_adamanip.collection.ray_cluster import LOCAL, connected
from lerobot_adamanip.util import files
from lerobot_adamanip.util.jobs import Beat, Crew, Work, WorkerPool

EPISODE_BYTES = 1_300_000


@contextlib.contextmanager
def session() -> Iterator[Work[int]]:
    """Items that take a second; what they return cannot be compressed."""
    content = os.urandom(EPISODE_BYTES)

    def work(item: int, beat: Beat) -> bytes:
        time.sleep(1.0)
        return content

    yield work


def seconds_per_item(crew: Crew[int], items: int, folder: Path) -> float:
    """Returns the time per item between the first result and the last, each written durably [s]."""
    times = []
    with crew:
        for result in crew.run(range(items)):
            assert isinstance(result.value, bytes)
            files.write_atomically(folder / str(result.item), result.value)
            times.append(time.monotonic())
    return (times[-1] - times[0]) / (len(times) - 1)


def main() -> None:
    """Measures both in turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, value in (("--workers", 2), ("--items", 30), ("--repeats", 5)):
        parser.add_argument(name, type=int, default=value)
    asked = parser.parse_args()
    found: dict[str, list[float]] = {"pool": [], "ray": []}
    with tempfile.TemporaryDirectory() as folder, connected(LOCAL, workers=asked.workers, insecure=False):
        from lerobot_adamanip.collection.ray_executor import RayCrew

        for _ in range(asked.repeats):
            pool = WorkerPool[int](session, asked.workers)
            found["pool"].append(seconds_per_item(pool, asked.items, Path(folder)))
            crew = RayCrew[int](session, asked.workers, timeout=600.0)
            found["ray"].append(seconds_per_item(crew, asked.items, Path(folder)))
    pool, ray = (statistics.median(found[name]) for name in ("pool", "ray"))
    summary = {"pool_s": pool, "ray_s": ray, "overhead_percent": 100 * (ray / pool - 1)}
    sys.stdout.write(json.dumps({**summary, **found}) + "\n")


if __name__ == "__main__":
    main()
