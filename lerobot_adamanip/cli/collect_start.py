"""How `adamanip collect` begins: which objects are meant, and what is said before the simulator is there."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from lerobot_adamanip.catalog import SEEN_COUNTS, object_split
from lerobot_adamanip.cli.external import select_placeable
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.evaluation.text_format import counted
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.jobs import preload

_WORKER_MODULES = (
    "lerobot_adamanip.collection.record",
    "lerobot_adamanip.experts",
    "lerobot_env_adamanip.fork_server_preload",
)
"""What workers that record need: imported while this process is busy with its own."""


def objects_to_collect(categories: Sequence[str], selection: str, assets: Path | None, poses: str) -> tuple[str, ...]:
    """Returns the ids of a selection, see `select_placeable`.

    Raises:
        ConfigurationError: there is no such selection, or a range of numbers runs on into the unseen objects, which
            tests are for: who wants these says so.
    """
    names = select_placeable(categories, selection, assets, poses)
    unseen = [name for name in names if assets is None and object_split(name) == "unseen"]
    if unseen and ":" in selection:
        count = min(SEEN_COUNTS[each] for each in categories)
        raise ConfigurationError(
            f"This range of objects holds {counted(len(unseen), 'unseen object')}, which are there for tests.",
            got=f"--objects {selection}",
            allowed=f"numbers up to {count}, seen, unseen, novel, nFIRST:nEND, or ids separated by commas",
            hint=f"--objects 0:{count}, or --objects unseen",
        )
    return names


def begin(spec: CollectionSpec, workers: int, cluster: str | None, part: str | None) -> None:
    """Says what is about to be recorded, and lets workers begin to import the simulator."""
    count = len(spec.objects) * spec.episodes_per_object
    splits = Counter(object_split(name) or "external" for name in spec.objects)
    told = ", ".join(f"{number} {split}" for split, number in splits.items())
    share = "" if part is None else f"part {part} of "
    where = f"on the cluster {cluster}" if cluster else f"starting {counted(workers, 'simulator')}"
    said = f"{share}{counted(count, 'episode')} of {counted(len(spec.objects), 'object')} ({told}), {where}"
    print(said, file=sys.stderr, flush=True)
    if cluster is None:
        preload(*_WORKER_MODULES)
