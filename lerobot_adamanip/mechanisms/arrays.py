"""What mechanisms compute with: torch tensors in a batch, NumPy arrays for one environment, by the same rules.

Operators, ``abs`` and comparisons mean the same in both. NumPy is ten times as fast on a single number, and a control
tick steps a mechanism; what the two spell differently is here.
"""

from __future__ import annotations

import sys
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np


def is_tensor(values: Any) -> bool:
    """Returns whether these are torch's. Only then is torch imported, which takes seconds."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(values, torch.Tensor)


def doubles(values: Any) -> Any:
    """Returns ``values`` (B,) as float64."""
    return values.double() if is_tensor(values) else np.asarray(values).astype(np.float64)


def filled(like: Any, value: float) -> Any:
    """Returns ``value`` in the shape of ``like`` (B,), float64."""
    if is_tensor(like):
        import torch

        return torch.full_like(like, value, dtype=torch.float64)
    return np.full_like(like, value, dtype=np.float64)


def where(condition: Any, chosen: Any, other: Any) -> Any:
    """Returns ``chosen`` where ``condition`` (B,) holds, ``other`` elsewhere; one of the two is an array."""
    return (sys.modules["torch"] if is_tensor(condition) else np).where(condition, chosen, other)


def as_arrays[StateT](state: StateT) -> StateT:
    """Returns a mechanism's state with its tensors as NumPy arrays."""
    if is_tensor(state):
        return state.numpy()  # type: ignore[attr-defined, no-any-return]
    if not is_dataclass(state) or isinstance(state, type):
        raise TypeError(f"a state is a dataclass of tensors, got {type(state).__name__}")
    return replace(state, **{item.name: as_arrays(getattr(state, item.name)) for item in fields(state)})
