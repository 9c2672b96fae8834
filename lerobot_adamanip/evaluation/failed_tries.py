"""What tries that failed were made at: a part that was held, its key, or a joint at its end. Pure functions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from lerobot_adamanip.evaluation.record import EpisodeRecord

PART_HELD, KEY_HELD, NO_FURTHER = "part held", "key held", "no further"
"""What opens gave no way, as what is locked does; nor did the other joint (knob, cap, lever), as one that turns the
other way does; a joint that had gone this way before went no further, as at its stop or out of the fingers."""
IN_VAIN = (PART_HELD, KEY_HELD, NO_FURTHER)


def failed_at(record: EpisodeRecord) -> list[str]:
    """Returns which of `IN_VAIN` each failed try of an episode was, in order."""
    went = set[tuple[int, int]]()
    found = []
    for joint, sign, fails in record.try_sequence:
        if not fails:
            went.add((joint, sign))
        elif (joint, sign) in went:
            found.append(NO_FURTHER)
        else:
            found.append(KEY_HELD if joint else PART_HELD)
    return found


def count_in_vain(records: Iterable[EpisodeRecord]) -> dict[str, int]:
    """Returns how many tries of the successes failed at each that there was, in the order of `IN_VAIN`."""
    found = Counter(kind for record in records if record.success for kind in failed_at(record))
    return {kind: found[kind] for kind in IN_VAIN if found[kind]}
