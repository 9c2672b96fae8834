"""Values of dataclass fields against their annotations, which Python does not check."""

from __future__ import annotations

import numbers
from dataclasses import fields
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from lerobot_adamanip.util.errors import ConfigurationError


def check_types(instance: Any) -> None:
    """Replaces the values of a dataclass by equal ones of the annotated types: a list by a tuple, NumPy's numbers.

    Raises:
        ConfigurationError: a value has another type. ``"false"`` is no bool, True no number, and 10.0 no int.
    """
    annotations = get_type_hints(type(instance))
    for item in fields(instance):
        value, annotation = getattr(instance, item.name), annotations[item.name]
        try:
            object.__setattr__(instance, item.name, _converted(value, annotation))
        except TypeError:
            allowed = getattr(annotation, "__name__", str(annotation)) if get_args(annotation) == () else annotation
            raise ConfigurationError(
                f"Wrong type of {item.name}.",
                got=f"{value!r:.80} ({type(value).__name__})",
                allowed=str(allowed).replace("collections.abc.", "").replace("typing.", ""),
                hint=f"{item.name}={item.default!r}",
            ) from None


def _converted(value: Any, annotation: Any) -> Any:
    """Returns the value as the annotation has it; raises TypeError."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if annotation is Any:
        return value
    if origin in (Union, UnionType):
        for part in parts:
            try:
                return _converted(value, part)
            except TypeError:
                continue
    elif origin is tuple and isinstance(value, list | tuple):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        if len(kinds) == len(value):
            return tuple(_converted(one, kind) for one, kind in zip(value, kinds, strict=True))
    elif annotation in (int, float):
        number = numbers.Integral if annotation is int else numbers.Real
        if isinstance(value, number) and not isinstance(value, bool):
            return annotation(value)
    elif isinstance(value, origin or annotation):
        return value
    raise TypeError
