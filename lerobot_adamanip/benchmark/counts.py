"""The numbers of a cell, as counts, so that those of several trainings can be added. Pure functions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lerobot_adamanip.evaluation.metrics import Tries, summarise, without_repeats
from lerobot_adamanip.evaluation.provenance import LINE
from lerobot_adamanip.evaluation.rates import SUCCESS_KEYS, Rate, rate, success_summary
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.recovery import Recovery
from lerobot_adamanip.util.json_fields import Check, integer, listing, mapping, number, optional, table, text

Counts = tuple[int, int]
"""How many, of how many."""


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """What came of the episodes of one method, category and split of objects.

    Attributes:
        success: share that was opened.
        key_frames: number of key frames -> successes that took as many.
        tries: failed tries of the successes; None without one.
        recovery: what followed a try that failed.
        hidden: name of a hidden value -> successes, episodes; see `groups.hidden_names`.
    """

    success: Rate
    key_frames: Mapping[int, int]
    tries: Tries | None
    recovery: Recovery
    hidden: Mapping[str, Counts]

    @classmethod
    def of(cls, records: Sequence[EpisodeRecord]) -> Numbers:
        """Counts episodes of one category, each once."""
        summary = summarise(records)
        successes = [record for record in without_repeats(records) if record.success]
        prefix = f"{records[0].category}: "
        return cls(
            success=summary.overall.success,
            key_frames=dict(sorted(Counter(record.key_frames for record in successes).items())),
            tries=summary.overall.tries,
            recovery=summary.recovery,
            hidden={
                group.name.removeprefix(prefix): (result.success.count, result.success.episodes)
                for group, result in summary.groups.items()
                if group.by == "hidden"
            },
        )

    def opened_within(self, key_frames: int) -> Rate:
        """Returns the share that was opened within so many key frames."""
        count = sum(opened for length, opened in self.key_frames.items() if length <= key_frames)
        return rate(count, self.success.episodes)

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary; the interval and LeRobot's keys are for other readers."""
        recovered = self.recovery
        return {
            "episodes": self.success.episodes,
            "successes": self.success.count,
            **success_summary(self.success),
            "interval": [self.success.low, self.success.high],
            "key_frames": {str(length): opened for length, opened in self.key_frames.items()},
            "tries": None if self.tries is None else asdict(self.tries),
            "recovery": {
                "repeated": [recovered.repeated.count, recovered.repeated.episodes],
                "untried": {str(failed): [each.count, each.episodes] for failed, each in recovered.untried.items()},
            },
            "hidden": {name: list(counts) for name, counts in self.hidden.items()},
        }

    @classmethod
    def from_json(cls, name: str, content: object) -> Numbers:
        """Returns the numbers in decoded JSON; raises ValueError that names what is wrong with them."""
        found = _NUMBERS(name, content)
        recovered, tries = found["recovery"], found["tries"]
        made = cls(
            success=rate(found["successes"], found["episodes"]),
            key_frames={int(length): opened for length, opened in found["key_frames"].items()},
            tries=None if tries is None else Tries(**tries),
            recovery=Recovery(
                rate(*recovered["repeated"]), {int(k): rate(*each) for k, each in recovered["untried"].items()}
            ),
            hidden={value: (each[0], each[1]) for value, each in found["hidden"].items()},
        )
        if sum(made.key_frames.values()) != made.success.count or (made.tries is None) != (made.success.count == 0):
            raise ValueError(f"{name} contradicts itself: {made.success.count} successes")
        return made


def pooled(several: Iterable[Numbers]) -> Numbers:
    """Returns the numbers of all episodes together; of at least one cell."""
    cells = list(several)
    solved = [(cell.success.count, cell.tries) for cell in cells if cell.tries is not None]
    successes = sum(count for count, _ in solved)

    def mean(value: Callable[[Tries], float]) -> float:
        return sum(count * value(tries) for count, tries in solved) / successes

    key_frames = Counter[int]()
    for cell in cells:
        key_frames.update(cell.key_frames)
    return Numbers(
        success=_together(cell.success for cell in cells),
        key_frames=dict(sorted(key_frames.items())),
        tries=Tries(mean(lambda t: t.made), mean(lambda t: t.best), mean(lambda t: t.wasted)) if solved else None,
        recovery=Recovery(
            _together(cell.recovery.repeated for cell in cells),
            {
                failed: _together(cell.recovery.untried[failed] for cell in cells if failed in cell.recovery.untried)
                for failed in sorted({failed for cell in cells for failed in cell.recovery.untried})
            },
        ),
        hidden={
            name: (sum(each[0] for each in counts), sum(each[1] for each in counts))
            for name in sorted({name for cell in cells for name in cell.hidden})
            if (counts := [cell.hidden[name] for cell in cells if name in cell.hidden])
        },
    )


def _together(rates: Iterable[Rate]) -> Rate:
    found = list(rates)
    return rate(sum(each.count for each in found), sum(each.episodes for each in found))


_COUNT, _SHARE, _MEAN = integer(0, 10**9), number(0, 1), number(-(10**6), 10**6)
_COUNTS = listing(_COUNT, 2, 2)
_WHOLE = text(r"\d{1,6}", "a whole number")
_NUMBERS: Check = table(
    {
        "episodes": integer(1, 10**9),
        "successes": _COUNT,
        "interval": listing(_SHARE, 2, 2),
        "key_frames": mapping(_WHOLE, _COUNT, 10_000),
        "tries": optional(table({"made": _MEAN, "best": _MEAN, "wasted": _MEAN})),
        "recovery": table({"repeated": _COUNTS, "untried": mapping(_WHOLE, _COUNTS, 1000)}),
        "hidden": mapping(LINE, _COUNTS, 100),
    },
    ignored=SUCCESS_KEYS,
)
