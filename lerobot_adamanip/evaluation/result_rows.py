"""The rows of a result: what came of the episodes of one subject, preset, category and split of objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.failed_tries import IN_VAIN, count_in_vain
from lerobot_adamanip.evaluation.failures import CAUSES, count_failures
from lerobot_adamanip.evaluation.groups import hidden_boundaries, hidden_names
from lerobot_adamanip.evaluation.metrics import group_result, without_repeats
from lerobot_adamanip.evaluation.provenance import LINE
from lerobot_adamanip.evaluation.rates import SUCCESS_KEYS, rate, success_summary
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.recovery import recovery
from lerobot_adamanip.util import json_fields as checked_json

OBJECT_SPLITS = ("seen", "unseen", "novel", "external")


@dataclass(frozen=True)
class ResultRow:
    """One number of a table.

    Attributes:
        subject: who acted, as a table calls it: ``adaptive``, ``dp3_adaptive, adaptive demonstrations``.
        preset: of the mechanisms.
        category: ``safe``.
        objects: ``seen``, ``unseen``, ``novel`` or ``external``.
        episodes: counted; failed and unreachable ones too.
        successes: of them.
        key_frames: mean of the successes; None without one.
        failed_tries: mean of the successes; None if not counted.
        hidden: hidden value's name -> (successes, episodes); see `groups.hidden_names`.
        wasted_tries: mean of the successes, beyond the best possible; None if not counted.
        repeated: failed tries that were repeated unchanged, and all that another try followed; None if not counted.
        train_minutes: that a policy was trained; None if not measured.
        failures: cause -> episodes, see `lerobot_adamanip.evaluation.failures`; None if not counted.
        in_vain: kind -> failed tries of the successes, see `evaluation.failed_tries`; None if not counted.
    """

    subject: str
    preset: str
    category: str
    objects: str
    episodes: int
    successes: int
    key_frames: float | None = None
    failed_tries: float | None = None
    hidden: Mapping[str, tuple[int, int]] | None = None
    wasted_tries: float | None = None
    repeated: tuple[int, int] | None = None
    train_minutes: float | None = None
    failures: Mapping[str, int] | None = None
    in_vain: Mapping[str, int] | None = None

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary, with LeRobot's keys for other readers."""
        return {**asdict(self), **success_summary(rate(self.successes, self.episodes))}


def parse_row(row: Mapping[str, Any]) -> ResultRow:
    """Returns the row in a JSON object that `ROW` has checked; raises ValueError if its numbers cannot be."""
    hidden = None if row["hidden"] is None else {name: tuple(pair) for name, pair in row["hidden"].items()}
    who = f"{row['subject']}, {row['category']}"
    for count, episodes in [(row["successes"], row["episodes"]), *(hidden or {}).values()]:
        if not 0 <= count <= episodes <= row["episodes"]:
            raise ValueError(f"{who}: {count} of {episodes} episodes cannot be")
    if sum((row["failures"] or {}).values()) not in (0, row["episodes"] - row["successes"]):
        raise ValueError(f"{who}: causes are not of the episodes that failed")
    if row["repeated"] is not None and row["repeated"][0] > row["repeated"][1]:
        raise ValueError(f"{who}: more tries are repeated than failed")
    return ResultRow(**{**row, "hidden": hidden})


def rows_of_records(
    records: Sequence[EpisodeRecord], subject: str, train_minutes: float | None = None
) -> list[ResultRow]:
    """Returns a row for each preset, category and split of objects in an evaluation's records."""
    kept = without_repeats(records)
    boundaries = hidden_boundaries(kept)
    found: dict[tuple[str, str, str], list[EpisodeRecord]] = {}
    for record in kept:
        key = (record.provenance.mechanism_rules, record.category, record.object_split or "external")
        found.setdefault(key, []).append(record)
    rows = []
    for (preset, category, objects), chosen in sorted(found.items(), key=lambda item: _row_order(*item[0])):
        result, hidden, again = group_result(chosen), dict[str, tuple[int, int]](), recovery(chosen).repeated
        for record in chosen:
            for name in hidden_names(category, record.hidden_state, boundaries):
                count, episodes = hidden.get(name, (0, 0))
                hidden[name] = (count + record.success, episodes + 1)
        rows.append(
            ResultRow(
                subject,
                preset,
                category,
                objects,
                result.success.episodes,
                result.success.count,
                result.key_frames_of_successes,
                None if result.tries is None else result.tries.made,
                dict(sorted(hidden.items())),
                None if result.tries is None else result.tries.wasted,
                (again.count, again.episodes),
                train_minutes,
                count_failures(chosen),
                count_in_vain(chosen),
            )
        )
    return rows


def _row_order(preset: str, category: str, objects: str) -> tuple[str, int, int]:
    return preset, tuple(CATEGORIES).index(category), OBJECT_SPLITS.index(objects)


_COUNT = checked_json.integer(0, 10**9)
ROW = checked_json.table(
    {
        "subject": LINE,
        "preset": checked_json.text(r"[a-z_]{1,30}", "a preset's name"),
        "category": checked_json.choice(tuple(CATEGORIES)),
        "objects": checked_json.choice(OBJECT_SPLITS),
        "episodes": checked_json.integer(1, 10**9),
        "successes": _COUNT,
        "key_frames": checked_json.optional(checked_json.number(0, 10**6)),
        "failed_tries": checked_json.optional(checked_json.number(0, 10**6)),
        "hidden": checked_json.optional(checked_json.mapping(LINE, checked_json.listing(_COUNT, 2, 2), 100)),
        "wasted_tries": checked_json.optional(checked_json.number(-(10**6), 10**6)),
        "repeated": checked_json.optional(checked_json.listing(_COUNT, 2, 2)),
        "train_minutes": checked_json.optional(checked_json.number(0, 10**6)),
        "failures": checked_json.optional(checked_json.mapping(checked_json.choice(CAUSES), _COUNT, len(CAUSES))),
        "in_vain": checked_json.optional(checked_json.mapping(checked_json.choice(IN_VAIN), _COUNT, len(IN_VAIN))),
    },
    ignored=SUCCESS_KEYS,
)
