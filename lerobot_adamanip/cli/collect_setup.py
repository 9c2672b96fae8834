"""Parts of `adamanip collect`: choice of objects and pictures, first and last output."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.catalog import SEEN_COUNTS, object_split, select_objects
from lerobot_adamanip.evaluation.text_format import counted
from lerobot_adamanip.mechanisms.table import unchanged_rules
from lerobot_adamanip.util.errors import GET_PICTURES, ConfigurationError, no_vulkan_device
from lerobot_adamanip.util.jobs import preload

if TYPE_CHECKING:
    from lerobot_adamanip.collection.summary import CollectSummary
    from lerobot_adamanip.datasets.collection_spec import CollectionSpec

_WORKER_MODULES = (
    "lerobot_adamanip.collection.record",
    "lerobot_adamanip.experts",
    "lerobot_env_adamanip.fork_server_preload",
)
"""Modules of recording workers, to be imported while this process does other things."""


def select_placeable(categories: Iterable[str], selection: str, assets: Path | None, poses: str) -> tuple[str, ...]:
    """Returns ids of objects, see `select_objects`, without external assets that the arm cannot reach."""
    placeable = None
    if assets is not None:
        from lerobot_env_adamanip.simulator import placement_check

        placeable = placement_check(poses)
    return tuple(name for each in categories for name in select_objects(each, selection, assets, placeable))


def objects_to_collect(categories: Sequence[str], selection: str, assets: Path | None, poses: str) -> tuple[str, ...]:
    """Returns the ids of a selection, see `select_placeable`.

    Raises:
        ConfigurationError: the selection is unknown, or a number range includes unseen objects. These are reserved for
            tests and must be selected by name.
    """
    names = select_placeable(categories, selection, assets, poses)
    unseen = [name for name in names if assets is None and object_split(name) == "unseen"]
    if unseen and ":" in selection:
        count = min(SEEN_COUNTS[each] for each in categories)
        raise ConfigurationError(
            f"This range of objects includes {counted(len(unseen), 'unseen object')}, which are for tests.",
            got=f"--objects {selection}",
            allowed=f"numbers up to {count}, seen, unseen, novel, nFIRST:nEND, or ids separated by commas",
            hint=f"--objects 0:{count}, or --objects unseen",
        )
    return names


def announce(spec: CollectionSpec, workers: int, cluster: str | None, part: str | None) -> None:
    """Prints what will be recorded, and makes workers begin to import the simulator."""
    episodes = counted(len(spec.objects) * spec.episodes_per_object, "episode")
    splits = Counter(object_split(name) or "external" for name in spec.objects)
    kinds = ", ".join(f"{number} {split}" for split, number in splits.items())
    share = "" if part is None else f"part {part} of "
    where = f"on the cluster {cluster}" if cluster else f"starting {counted(workers, 'simulator')}"
    objects = counted(len(spec.objects), "object")
    print(
        f"{share}{episodes} of {objects} ({kinds}), {where}. The first episode takes up to a minute.",
        file=sys.stderr,
        flush=True,
    )
    if line := unchanged_rules(spec.categories, spec.environment.mechanism_rules):
        print(line, file=sys.stderr)
    if cluster is None:
        preload(*_WORKER_MODULES)


def require_renderer() -> None:
    """Raises `SimulatorError` if this machine cannot render."""
    from lerobot_env_adamanip.sim.render_device import can_render

    if not can_render():
        raise no_vulkan_device("no Vulkan driver, or none that takes a picture")


def resolve_images(roots: Sequence[Path], required: bool) -> bool:
    """Returns whether a collection has pictures.

    An existing collection keeps its choice. A new one has pictures on a machine that can render; otherwise a line on
    stderr says that there are none.

    Args:
        roots: folders of the dataset, and of adopted parts.
        required: whether to raise `SimulatorError` on a machine that cannot render.
    """
    from lerobot_adamanip.datasets.collection_spec import CollectionPaths
    from lerobot_adamanip.datasets.manifest import stored_images
    from lerobot_env_adamanip.sim.render_device import can_render

    if required:
        require_renderer()
        return True
    choices = (stored_images(CollectionPaths(root.absolute())) for root in roots)
    if (stored := next((choice for choice in choices if choice is not None), None)) is not None:
        return stored
    if can_render():
        return True
    print(no_pictures("adamanip render"), file=sys.stderr)
    return False


def no_pictures(command: str) -> str:
    """Returns the line about a dataset without pictures; ``command`` adds them later."""
    return f"No pictures: nothing renders here. `{command}` adds them later. To get them: {GET_PICTURES}."


def summary_text(summary: CollectSummary, part: str | None, adopted: Sequence[Path], driver: str) -> str:
    """Returns the command's last output.

    Args:
        summary: summary of the run.
        part: that was recorded, if any.
        adopted: roots of imported parts.
        driver: ``expert`` or ``policy``.
    """
    if part is not None:
        return f"Part {part}: {summary.episodes} episodes in {summary.root}, {summary.recorded} of them new."
    if summary.recorded == 0 and not adopted:
        return f"Complete: {summary.episodes} episodes in {summary.root}, none of them recorded by this run."
    lines = [
        f"{summary.episodes} episodes in {summary.root} ({summary.bytes / 1e6:.1f} MB): "
        f"{summary.recorded} recorded in {summary.recording_seconds:.0f} s, "
        f"{summary.episodes_per_minute:.1f} per minute; the {driver} succeeded in "
        f"{100 * summary.success_rate:.1f} % of its {summary.attempted} attempts."
    ]
    if len(summary.categories) > 1:
        lines.append(
            f"{'category':16} {'episodes':>8} {'attempts':>8} {'key frames':>10} {'per worker and minute':>21}"
        )
        for name, row in summary.categories.items():
            rate = f"{row.episodes_per_worker_minute:.1f}" if row.recorded else "-"
            lines.append(f"{name:16} {row.episodes:8} {row.attempts:8} {row.mean_key_frames:10.1f} {rate:>21}")
    return "\n".join([*lines, *(f"missing: {line}" for line in summary.failures)])
