"""Which episodes are looked at together: by category, by split of objects and of scenes, by whatever is hidden."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from lerobot_adamanip.evaluation.record import EpisodeRecord, HiddenValue

Boundaries = Mapping[tuple[str, str], float]
"""(category, hidden name) -> value that parts a continuous range in two."""
_OBJECT_SPLITS, _SCENE_SPLITS = ("seen", "unseen", "novel", "external"), ("test", "validation", "train", "other")


@dataclass(frozen=True)
class Group:
    """A set of episodes by what they have in common.

    Attributes:
        by: ``all``, ``category``, ``objects``, ``category and objects``, ``scenes`` or ``hidden``.
        name: what they have in common: ``safe``, ``unseen``, ``safe, unseen``, ``test``, ``safe: locked``.
    """

    by: str
    name: str

    @property
    def label(self) -> str:
        """How a table or picture calls it."""
        return f"{self.name} {self.by}" if self.by in ("objects", "scenes") else self.name


ALL = Group("all", "all")


def hidden_boundaries(records: Iterable[EpisodeRecord]) -> dict[tuple[str, str], float]:
    """Returns the medians of the continuous hidden values, by category; to three digits, so that a name can tell it.

    Evaluations that are compared need the same ones: take them of all records together.
    """
    values: dict[tuple[str, str], list[float]] = {}
    for record in records:
        for name, value in record.hidden_state.items():
            if isinstance(value, float):
                values.setdefault((record.category, name), []).append(value)
    return {key: float(f"{statistics.median(found):.3g}") for key, found in values.items()}


def hidden_names(category: str, hidden: Mapping[str, HiddenValue], boundaries: Boundaries) -> Iterator[str]:
    """Yields what a hidden state is called: ``locked``, ``direction +1``, ``mode 2``, ``turn_range < 1.1``."""
    for name, value in sorted(hidden.items()):
        if isinstance(value, bool):
            yield name if value else ("unlocked" if name == "locked" else f"not {name}")
        elif isinstance(value, float):
            boundary = boundaries[category, name]
            yield f"{name} {'<' if value < boundary else '>='} {boundary:g}"
        else:
            yield f"{name} {value:+d}" if name == "direction" else f"{name} {value}"


def groups_of(record: EpisodeRecord, boundaries: Boundaries) -> Iterator[Group]:
    """Yields every group an episode belongs to."""
    objects = record.object_split or "external"
    yield ALL
    yield Group("category", record.category)
    yield Group("objects", objects)
    yield Group("category and objects", f"{record.category}, {objects}")
    yield Group("scenes", record.split or "other")
    for name in hidden_names(record.category, record.hidden_state, boundaries):
        yield Group("hidden", f"{record.category}: {name}")


def group_records(
    records: Sequence[EpisodeRecord], boundaries: Boundaries | None = None
) -> dict[Group, list[EpisodeRecord]]:
    """Returns group -> its episodes, all first, then by kind of group.

    Args:
        records: each episode once.
        boundaries: see `hidden_boundaries`; of these records if left out.
    """
    parting = hidden_boundaries(records) if boundaries is None else boundaries
    found: dict[Group, list[EpisodeRecord]] = {ALL: []}
    for record in records:
        for group in groups_of(record, parting):
            found.setdefault(group, []).append(record)
    return {group: found[group] for group in sorted(found, key=_order)}


def _order(group: Group) -> tuple[int, int, str]:
    kinds = ("all", "category", "objects", "category and objects", "scenes", "hidden")
    order = {"objects": _OBJECT_SPLITS, "scenes": _SCENE_SPLITS}.get(group.by, ())
    return (kinds.index(group.by), order.index(group.name) if group.name in order else 0, group.name)


def worth_showing(groups: Iterable[Group]) -> list[Group]:
    """Returns the groups less those that only repeat another: one category is all there is, one split of scenes too."""
    chosen = list(groups)
    names = {by: {group.name for group in chosen if group.by == by} for by in ("category", "objects", "scenes")}
    dull = {by for by in ("category", "scenes") if len(names[by]) < 2}
    if len(names["category"]) < 2 or len(names["objects"]) < 2:
        dull.add("category and objects")
    return [group for group in chosen if group.by not in dull]
