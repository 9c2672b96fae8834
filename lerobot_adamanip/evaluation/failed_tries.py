"""Failed tries by part and kind: which part was pulled, pushed or turned in vain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # records import scipy; `adamanip stats --help` needs none
    from lerobot_adamanip.evaluation.record import EpisodeRecord

TURNED = "turned"
KINDS_OF_TRIES = {
    "bottle": ("cap pulled", "cap turned"), "pen": ("cap pulled", "cap turned"), "safe": ("door pulled", "knob turned"),
    "pressure_cooker": ("lid pulled", "lid turned"), "coffee_maker": ("portafilter pulled", "portafilter turned"),
    "microwave": ("door pulled", "button pushed"), "window": ("sash pulled", "handle turned"),
    "door": ("leaf pulled", "lever turned"), "lamp": ("button pushed", "knob turned"),
}  # fmt: skip
"""Category -> tries of its joints, in the order of the mechanism's `joints`: the one that opens comes first."""
FailedTries = Mapping[str, Mapping[str, int]]
"""Category -> kind of try -> number of failed ones."""


def kind_of_try(category: str, joint: int, sign: int) -> str:
    """Returns part and kind of a try: ``knob turned +``, ``door pulled``, ``door pulled, back``."""
    kind = KINDS_OF_TRIES[category][joint]
    if kind.endswith(TURNED):
        return f"{kind} {'+' if sign > 0 else '-'}"
    return kind if sign > 0 else f"{kind}, back"


def failed_tries_by_kind(records: Iterable[EpisodeRecord]) -> dict[str, dict[str, int]]:
    """Returns the failed tries of episodes by category and kind, the most frequent kind first."""
    counts: dict[str, Counter[str]] = {}
    for record in records:
        kinds = (kind_of_try(record.category, joint, sign) for joint, sign, failed in record.counted_tries if failed)
        counts.setdefault(record.category, Counter()).update(kinds)
    return {category: dict(kinds.most_common()) for category, kinds in sorted(counts.items())}


def failed_tries_text(tries: FailedTries) -> list[str]:
    """Returns a line per category: ``safe: door pulled 12, knob turned + 3``."""
    return [
        f"{category}: {', '.join(f'{kind} {count}' for kind, count in kinds.items()) or 'none'}"
        for category, kinds in tries.items()
    ]
