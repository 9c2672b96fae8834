"""Conversion of metrics in result files of version 0.2, which had two forms, to those of `Metrics`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.evaluation.tries import CAUSES, FAILED_AT


def modernised(content: Any) -> dict[str, Any]:
    """Returns metrics in decoded JSON under the names of `Metrics`; raises TypeError or KeyError for other JSON."""
    found = dict(content)
    if "tried_locked_first" in found:
        return found
    successes = found.get("successes")

    def mean(value: object) -> object:
        return value if value is None else {"mean": value, "of": successes}

    if "tries" in found:  # a cell of a benchmark
        tries, recovery = found.pop("tries") or {}, found.pop("recovery", None) or {}
        return {**found, **recovery, **{f"{new}_tries": mean(tries.get(old)) for new, old in _TRIES.items()}}
    if isinstance(length := found.get("key_frames"), int | float):
        found["key_frames"] = {f"{length:.17f}".rstrip("0"): successes}
    if isinstance(counts := found.get("failures"), Mapping):
        found["failures"] = {**dict.fromkeys(CAUSES, 0), **counts}
    if isinstance(counts := found.pop("in_vain", None), Mapping):
        found["failed_at"] = {kind: mean(counts.get(kind, 0) / max(1, successes or 0)) for kind in FAILED_AT}
    return {**found, **{name: mean(found.get(name)) for name in ("failed_tries", "wasted_tries")}}


_TRIES = {"failed": "made", "wasted": "wasted"}
