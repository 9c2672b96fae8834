"""Groups of episodes: by category, by split of objects and of scenes, by hidden value."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from lerobot_adamanip.evaluation.record import EpisodeRecord, HiddenValue

Boundaries = Mapping[tuple[str, str], float]
"""(category, hidden name) -> median that halves a continuous range."""
OBJECT_SPLITS, _SCENE_SPLITS = ("seen", "unseen", "novel", "external"), ("test", "validation", "train", "other")


@dataclass(frozen=True)
class Group:
    """Episodes with a common property.

    Attributes:
        by: ``all``, ``category``, ``objects``, ``category and objects``, ``scenes`` or ``hidden``.
        name: ``safe``, ``unseen``, ``safe, unseen``, ``test`` or ``safe: locked``.
    """

    by: str
    name: str

    @property
    def label(self) -> str:
        """Name in tables and plots."""
        return f"{self.name} {self.by}" if self.by in ("objects", "scenes") else self.name


ALL = Group("all", "all")


def hidden_boundaries(records: Iterable[EpisodeRecord]) -> dict[tuple[str, str], float]:
    """Returns the medians of the continuous hidden values by category, to three digits.

    Evaluations are comparable only with equal boundaries: pass the records of all of them.
    """
    values: dict[tuple[str, str], list[float]] = {}
    for record in records:
        for name, value in record.hidden_state.items():
            if isinstance(value, float):
                values.setdefault((record.category, name), []).append(value)
    return {key: float(f"{statistics.median(found):.3g}") for key, found in values.items()}


def hidden_names(category: str, hidden: Mapping[str, HiddenValue], boundaries: Boundaries) -> Iterator[str]:
    """Yields the names of a hidden state's values: ``locked``, ``direction +1``, ``mode 2``, ``turn_range < 1.1``."""
    for name, value in sorted(hidden.items()):
        if isinstance(value, bool):
            yield name if value else ("unlocked" if name == "locked" else f"not {name}")
        elif isinstance(value, float):
            boundary = boundaries[category, name]
            yield f"{name} {'<' if value < boundary else '>='} {boundary:g}"
        else:
            yield f"{name} {value:+d}" if name == "direction" else f"{name} {value}"


def is_half_of_range(name: str) -> bool:
    """Returns whether a name means half of a continuous range; the boundary differs between evaluations."""
    return " < " in name or " >= " in name


def groups_of(record: EpisodeRecord, boundaries: Boundaries) -> Iterator[Group]:
    """Yields every group that an episode belongs to."""
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
    """Returns group -> its episodes: ``all`` first, then sorted by kind of group.

    Args:
        records: unique episodes.
        boundaries: see `hidden_boundaries`; by default those of these records.
    """
    parting = hidden_boundaries(records) if boundaries is None else boundaries
    found: dict[Group, list[EpisodeRecord]] = {ALL: []}
    for record in records:
        for group in groups_of(record, parting):
            found.setdefault(group, []).append(record)
    return {group: found[group] for group in sorted(found, key=_order)}


def _order(group: Group) -> tuple[int, int, str]:
    kinds = ("all", "category", "objects", "category and objects", "scenes", "hidden")
    order = {"objects": OBJECT_SPLITS, "scenes": _SCENE_SPLITS}.get(group.by, ())
    return (kinds.index(group.by), order.index(group.name) if group.name in order else 0, group.name)


def worth_showing(groups: Iterable[Group]) -> list[Group]:
    """Returns the groups without repeats: with a single category, its group equals ``all``."""
    chosen = list(groups)
    names = {by: {group.name for group in chosen if group.by == by} for by in ("category", "objects", "scenes")}
    dull = {by for by in ("category", "scenes") if len(names[by]) < 2}
    if len(names["category"]) < 2 or len(names["objects"]) < 2:
        dull.add("category and objects")
    return [group for group in chosen if group.by not in dull]


def without_repeats(records: Iterable[EpisodeRecord]) -> list[EpisodeRecord]:
    """Returns the records with each episode once: the last one of equal episodes, in order.

    Episodes are equal if seed, object and hidden state are. A seed on seen and on unseen objects is two episodes.
    """
    last: dict[tuple[object, ...], EpisodeRecord] = {}
    for record in records:
        last.pop(record.identity, None)
        last[record.identity] = record
    return list(last.values())


def split_evaluations(records: Iterable[EpisodeRecord], *, pool: bool = False) -> list[list[EpisodeRecord]]:
    """Returns the records of each `EpisodeRecord.evaluation` in a log, in order of appearance.

    Scene splits stay separate, even if ``pool`` merges all evaluations.
    """
    found: dict[tuple[object, ...], list[EpisodeRecord]] = {}
    for record in records:
        found.setdefault((None if pool else record.evaluation, record.split), []).append(record)
    return list(found.values())


def first_episodes(records: Iterable[EpisodeRecord], count: int) -> list[EpisodeRecord]:
    """Returns the first ``count`` episodes of each evaluation and category, as ``lerobot-eval`` counts them.

    LeRobot runs ``ceil(n_episodes / batch_size)`` whole batches with consecutive seeds and counts the ``n_episodes``
    with the lowest seeds. The log also contains the surplus of the last batch, unless ``--env.logged_seeds`` excludes
    it.
    (LeRobot 0.6.1, `lerobot.scripts.lerobot_eval.eval_policy`.)
    """
    found: dict[tuple[object, ...], list[EpisodeRecord]] = {}
    for record in records:
        found.setdefault((record.evaluation, record.category), []).append(record)
    counted = [set(sorted({each.given_seed for each in group})[:count]) for group in found.values()]
    return [
        each for group, seeds in zip(found.values(), counted, strict=True) for each in group if each.given_seed in seeds
    ]
