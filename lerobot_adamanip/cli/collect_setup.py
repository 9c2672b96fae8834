"""What `adamanip collect` decides before anything is recorded: objects, pictures, and what it says at the start."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from lerobot_adamanip.catalog import SEEN_COUNTS, object_split, select_objects
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec
from lerobot_adamanip.datasets.manifest import stored_images
from lerobot_adamanip.util.errors import GET_PICTURES, ConfigurationError, no_vulkan_device
from lerobot_adamanip.util.jobs import preload

_WORKER_MODULES = (
    "lerobot_adamanip.collection.record",
    "lerobot_adamanip.experts",
    "lerobot_env_adamanip.fork_server_preload",
)
"""Modules that recording workers need: imported while this process is busy with its own."""


def select_placeable(categories: Iterable[str], selection: str, assets: Path | None, poses: str) -> tuple[str, ...]:
    """Returns ids of objects, see `select_objects`; external assets that the arm cannot reach are left out."""
    placeable = None
    if assets is not None:
        from lerobot_env_adamanip.simulator import placement_check

        placeable = placement_check(poses)
    return tuple(name for each in categories for name in select_objects(each, selection, assets, placeable))


def objects_to_collect(categories: Sequence[str], selection: str, assets: Path | None, poses: str) -> tuple[str, ...]:
    """Returns the ids of a selection, see `select_placeable`.

    Raises:
        ConfigurationError: there is no such selection, or a range of numbers includes unseen objects, which are for
            tests and have to be selected by name.
    """
    names = select_placeable(categories, selection, assets, poses)
    unseen = [name for name in names if assets is None and object_split(name) == "unseen"]
    if unseen and ":" in selection:
        count = min(SEEN_COUNTS[each] for each in categories)
        raise ConfigurationError(
            f"This range of objects holds {_count(len(unseen), 'unseen object')}, which are there for tests.",
            got=f"--objects {selection}",
            allowed=f"numbers up to {count}, seen, unseen, novel, nFIRST:nEND, or ids separated by commas",
            hint=f"--objects 0:{count}, or --objects unseen",
        )
    return names


def begin(spec: CollectionSpec, workers: int, cluster: str | None, part: str | None) -> None:
    """Prints what is about to be recorded, and lets workers begin to import the simulator."""
    episodes = _count(len(spec.objects) * spec.episodes_per_object, "episode")
    splits = Counter(object_split(name) or "external" for name in spec.objects)
    kinds = ", ".join(f"{number} {split}" for split, number in splits.items())
    share = "" if part is None else f"part {part} of "
    where = f"on the cluster {cluster}" if cluster else f"starting {_count(workers, 'simulator')}"
    objects = _count(len(spec.objects), "object")
    print(f"{share}{episodes} of {objects} ({kinds}), {where}", file=sys.stderr, flush=True)
    if cluster is None:
        preload(*_WORKER_MODULES)


def can_render() -> bool:
    """Returns whether anything renders on this machine."""
    from lerobot_env_adamanip.sim.render_device import can_render as probe

    return probe()


def require_renderer() -> None:
    """Raises `SimulatorError` if nothing renders on this machine."""
    if not can_render():
        raise no_vulkan_device("no Vulkan driver, or none that takes a picture")


def resolve_images(roots: Sequence[Path], wanted: bool, refused: bool) -> bool:
    """Returns whether a collection has pictures.

    An existing collection keeps its own choice; a new one has pictures where something renders, and a line on stderr
    says so where nothing does.

    Args:
        roots: of the dataset, and of parts whose episodes it takes over.
        wanted: --images was given.
        refused: --no-images was given.

    Raises:
        ConfigurationError: both were given.
        SimulatorError: pictures are wanted, and nothing renders here.
    """
    if wanted and refused:
        raise ConfigurationError(
            "Contradicting options.",
            got="--images --no-images",
            allowed="one of them, or neither: pictures where something renders",
            hint="leave one out",
        )
    if refused:
        return False
    stored = [stored_images(CollectionPaths(root.absolute())) for root in roots]
    if not wanted and (known := [each for each in stored if each is not None]):
        return known[0]
    if wanted:
        require_renderer()
    if wanted or can_render():
        return True
    print(
        f"No pictures: nothing renders here. `adamanip render` adds them later. To get them: {GET_PICTURES}.",
        file=sys.stderr,
    )
    return False


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
