"""Splits of scenes: each seed belongs to training, validation or test, so the three never overlap.

An episode's seed defines its scene: object, poses and hidden state. LeRobot seeds evaluations itself (1000 and up in
``lerobot-eval``, ``--seed`` and up while training), so an evaluation's seed is mapped into its split's range.
"""

from __future__ import annotations

import numpy as np

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.errors import require_choice

SPLITS = {"test": (0, 10**6), "validation": (10**6, 2 * 10**6), "train": (2**24, 2**31)}
"""Split -> first seed, end. ``train``: demonstrations; ``validation``: model selection; ``test``: reported numbers."""

CATEGORY_STRIDE = 100_000
"""Seed offset between the categories of a suite; otherwise equal seeds give similar poses and hidden states."""

CHOOSE_SPLIT = (
    "--env.split=validation (the default, also while training); --env.split=test for numbers that are reported"
)


def scene_seed(seed: int, split: str) -> int:
    """Returns the seed of a split's scene: ``seed`` if it lies in the split's range, else wrapped into it.

    Equal seeds give equal scenes; consecutive seeds give different ones.

    Args:
        seed: any whole number, 0 or larger.
        split: see `SPLITS`; raises `ConfigurationError` for another name.
    """
    first, end = SPLITS[require_choice("split of scenes", split, SPLITS, hint=CHOOSE_SPLIT)]
    return seed if first <= seed < end else first + seed % (end - first)


def category_offset(category: str) -> int:
    """Returns the number added to seeds of a category in a suite; see `CATEGORY_STRIDE`."""
    return CATEGORY_STRIDE * list(CATEGORIES).index(category)


def split_of(seed: int) -> str | None:
    """Returns the split a scene's seed belongs to; None for a seed of no split."""
    return next((name for name, (first, end) in SPLITS.items() if first <= seed < end), None)


def retried_seed(seed: int, split: str, attempt: int) -> int:
    """Returns the seed of the ``attempt``-th replacement for a scene, in the same split."""
    drawn = np.random.SeedSequence([seed, attempt]).generate_state(1)[0]
    return scene_seed(int(drawn), split)
