"""How far episodes that failed had come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from lerobot_adamanip.evaluation.record import EpisodeRecord

NO_TRY, IN_VAIN, KEY_MOVED, AJAR = "no try", "tried in vain", "key moved", "ajar"
"""Nothing was tried, so nothing was in the hand; no joint moved; the other joint did (knob, cap, lever); what opens
did, and not far enough."""
CAUSES = (NO_TRY, IN_VAIN, KEY_MOVED, AJAR)
AJAR_FROM = 5e-3
"""Of the joint that opens [rad or m]."""


def failure_cause(record: EpisodeRecord) -> str | None:
    """Returns which of `CAUSES` an episode failed by; None for a success."""
    if record.success:
        return None
    opens = next(iter(record.joints.values()), 0.0)
    if abs(opens) > AJAR_FROM:
        return AJAR
    if not record.try_sequence:
        return NO_TRY
    return KEY_MOVED if record.key_moved else IN_VAIN


def count_failures(records: Iterable[EpisodeRecord]) -> dict[str, int]:
    """Returns how many episodes failed by each cause that there was, in the order of `CAUSES`."""
    found = Counter(map(failure_cause, records))
    return {cause: found[cause] for cause in CAUSES if found[cause]}


def failures_text(failures: Mapping[str, int]) -> str:
    """Returns ``ajar 7, no try 1``, or ``none``."""
    return ", ".join(f"{cause} {count}" for cause, count in failures.items()) or "none"
