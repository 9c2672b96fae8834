"""Seeds: splits of scenes, and the streams of random numbers that follow from an episode's seed.

Each seed belongs to training, validation or test, so the three never overlap. An episode's seed defines its scene:
object, poses and hidden state. LeRobot seeds evaluations itself (1000 and up in ``lerobot-eval``, ``--seed`` and up
while training), so an evaluation's seed is mapped into its split's range.
"""

from __future__ import annotations

import enum

import numpy as np

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.errors import require_choice

SPLITS = {"test": (0, 10**6), "validation": (10**6, 2 * 10**6), "train": (2**24, 2**31)}
"""Split -> first seed, end. ``train``: demonstrations; ``validation``: model selection; ``test``: reported numbers."""
MAX_SEED = 2**31 - 1
"""Largest seed of a reset: logs, datasets and results hold no larger one."""

CATEGORY_STRIDE = 100_000
"""Seed offset between the categories of a suite, whose scenes differ from those of a single category."""

CHOOSE_SPLIT = (
    "--env.split=validation (the default, also while training); --env.split=test for numbers that are reported"
)


BALANCED_BLOCK = 12
"""Number of consecutive seeds in which each half, third and quarter of a hidden value's range occurs equally often."""


class Stream(enum.IntEnum):
    """Streams of random numbers of one episode. Each use has a stream of its own, and all are listed here."""

    PLACEMENT = 0
    HIDDEN = 1
    OBJECT = 2
    CAMERA = 3
    EXPERT = 4
    LATE_START = 5
    LATE_EXPERT = 6
    CORRECTION = 7
    RETRY = 8
    SENSING = 9
    HINT = 10
    MISTAKE = 11


def episode_generator(seed: int, stream: Stream, category: str, *moment: int) -> np.random.Generator:
    """Returns the generator of one stream. Streams and categories differ in all numbers, also for equal seeds.

    With a ``moment``, one or more numbers above 0, it is the generator of a moment of the episode.
    """
    return np.random.default_rng([seed, stream, list(CATEGORIES).index(category), *moment])


class BalancedDraws:
    """Uniform random numbers for the hidden values of an episode, balanced over consecutive seeds.

    The k-th call of `random` draws the k-th value. In each block of `BALANCED_BLOCK` seeds, the k-th values fall once
    into each of as many equal parts of [0, 1), in random order, so a value's share hardly depends on the seeds chosen.
    Values with different k, and of different categories, are independent.
    """

    def __init__(self, seed: int, category: str) -> None:
        self._block, self._place = divmod(seed, BALANCED_BLOCK)
        self._category, self._count = category, 0

    def random(self) -> float:
        """Returns the next number in [0, 1)."""
        key = [self._block, Stream.HIDDEN, list(CATEGORIES).index(self._category), self._count]
        rng = np.random.default_rng(key)
        self._count += 1
        part, within = rng.permutation(BALANCED_BLOCK)[self._place], rng.random(BALANCED_BLOCK)[self._place]
        return float((part + within) / BALANCED_BLOCK)


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
    """Returns the split of a scene's seed; None outside all splits."""
    return next((name for name, (first, end) in SPLITS.items() if first <= seed < end), None)


def retried_seed(seed: int, split: str, attempt: int) -> int:
    """Returns the seed of the ``attempt``-th replacement for a scene, in the same split."""
    drawn = np.random.SeedSequence([seed, Stream.RETRY, attempt]).generate_state(1)[0]
    return scene_seed(int(drawn), split)
