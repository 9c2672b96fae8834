"""Patch: give policies the robot's memory in a column of its own in ``lerobot-rollout``.

Changes:
    `lerobot.rollout.context`: its two functions that make the features of observations, see `split_memory`.
Why:
    LeRobot puts all numbers of a robot into ``observation.state``. Policies are trained with the memory in
    ``observation.environment_state``, as environments have it.
Without it:
    A policy that was trained with ``--memory events`` fails on a robot at its first observation: the state is too long.
Upstream:
    None filed. `Robot.observation_features` has no way to name a column.
Needed for:
    0.6.1, tested.
Guard:
    ``build_rollout_context`` calls both functions by their global names.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from lerobot_adamanip.hardware.features import split_memory
from lerobot_adamanip.lerobot_patches.support import UnsupportedError, loaded, replace

CONTEXT = "lerobot.rollout.context"
MAKERS = ("combine_feature_dicts", "hw_to_dataset_features")
"""Functions that make the features of a rollout's dataset, and those of its observations."""


def apply() -> None:
    """Applies the patch. Raises `UnsupportedError` for a rollout that makes its features in another way."""
    module = loaded(CONTEXT)
    build = getattr(module, "build_rollout_context", None)
    called = build.__code__.co_names if callable(build) else ()
    if missing := [name for name in MAKERS if name not in called or name not in vars(module)]:
        raise UnsupportedError(f"its rollout does not call {', '.join(missing)}")
    for name in MAKERS:
        replace(module, name, splitting(getattr(module, name)))


def splitting(stock: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """Returns LeRobot's function, whose features then have the memory in a column of its own."""

    @functools.wraps(stock)
    def make(*args: Any, **kwargs: Any) -> dict[str, Any]:
        return split_memory(stock(*args, **kwargs))

    return make
