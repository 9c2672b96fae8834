"""Values of metrics: a `Rate`, a `Mean`, a count, or a mapping of them; encoding, formatting and addition."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from lerobot_adamanip.evaluation.groups import is_half_of_range
from lerobot_adamanip.evaluation.provenance import LINE
from lerobot_adamanip.evaluation.rates import Rate, rate
from lerobot_adamanip.util.json_fields import integer, listing, mapping, number, table

COUNT = integer(0, 10**9)
_PAIR = listing(COUNT, 2, 2)
_MEAN = table({"mean": number(-(10**6), 10**6), "of": COUNT})


@dataclass(frozen=True)
class Mean:
    """Mean over ``count`` episodes; ``value`` is None without episodes."""

    total: float
    count: int

    @property
    def value(self) -> float | None:
        """Mean value; None without episodes."""
        return self.total / self.count if self.count else None


def encode(value: Any) -> Any:
    """Returns a value as JSON: a rate as ``[count, episodes]``, a mean as ``{"mean", "of"}``."""
    if isinstance(value, Rate):
        return [value.count, value.episodes]
    if isinstance(value, Mean):
        return {"mean": value.value or 0.0, "of": value.count}
    return {str(name): encode(each) for name, each in value.items()} if isinstance(value, Mapping) else value


def decode(name: str, value: object) -> Any:
    """Returns the value in decoded JSON; raises ValueError if it is invalid."""
    if isinstance(value, list):
        return rate(*_PAIR(name, value))
    if not isinstance(value, Mapping):
        return COUNT(name, value)
    if "of" in value:
        found = _MEAN(name, value)
        return Mean(found["mean"] * found["of"], found["of"])
    return mapping(_key, decode, 10_000)(name, value)


def _key(name: str, value: object) -> str | int | float:
    key = str(LINE(name, value))
    if key.isdecimal():
        return int(key)
    return float(key) if key.replace(".", "", 1).isdecimal() else key


def show(value: Any) -> str:
    """Returns a value as text; omits zeros in mappings and halves of continuous hidden values."""
    if isinstance(value, Rate):
        return f"{value.count}/{value.episodes}"
    if isinstance(value, Mean):
        return "-" if value.value is None else f"{value.value:.2f}"
    if not isinstance(value, Mapping):
        return str(value)
    if value and all(isinstance(each, Mean) and not each.count for each in value.values()):
        return "-"
    told = {str(name): show(each) for name, each in value.items() if not is_half_of_range(str(name))}
    return ", ".join(f"{name} {each}" for name, each in told.items() if each not in ("0", "0.00")) or "none"


def add(values: Iterable[Any]) -> Any:
    """Returns the sum of a metric's values; ignores None, which means not measured."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    if isinstance(known[0], Rate):
        return rate(sum(each.count for each in known), sum(each.episodes for each in known))
    if isinstance(known[0], Mean):
        return Mean(sum(each.total for each in known), sum(each.count for each in known))
    if isinstance(known[0], Mapping):
        names = dict.fromkeys(name for each in known for name in each)
        return {name: add(each.get(name) for each in known) for name in names}
    return sum(known)


def mean_length(lengths: Mapping[float, int] | None) -> float | None:
    """Returns the mean of a mapping length -> count; None if it is empty."""
    count = sum((lengths or {}).values())
    return sum(length * each for length, each in (lengths or {}).items()) / count if count else None
