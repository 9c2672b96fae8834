"""The cells of a benchmark: one training of one method, tested on one split of one category's objects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from lerobot_adamanip.benchmark.declaration import Declaration
from lerobot_adamanip.benchmark.declaration_fields import OBJECT_SPLITS
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.errors import ConfigurationError, require_choice


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One number of a benchmark.

    Attributes:
        method: name.
        category: of the objects.
        objects: split of objects that it is tested on.
        seed: of the training.
        trials: in the demonstrations, for a point of the curve over trials; None for the table.
    """

    method: str
    category: str
    objects: str
    seed: int
    trials: int | None = None

    @property
    def name(self) -> str:
        """A file name: ``dp3_adaptive-safe-seen-1000``, ``dp3_adaptive-trials3-safe-seen-1000``."""
        trials = () if self.trials is None else (f"trials{self.trials}",)
        return "-".join((self.method, *trials, self.category, self.objects, str(self.seed)))


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Which cells are wanted; an empty tuple stands for all."""

    methods: tuple[str, ...] = ()
    categories: tuple[str, ...] = ()
    splits: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()

    def __contains__(self, cell: Cell) -> bool:
        asked: tuple[tuple[Any, tuple[Any, ...]], ...] = (
            (cell.method, self.methods),
            (cell.category, self.categories),
            (cell.objects, self.splits),
            (cell.seed, self.seeds),
        )
        return all(not wanted or value in wanted for value, wanted in asked)


def all_cells(declaration: Declaration, scale: str) -> list[Cell]:
    """Returns the cells of a scale, category by category: so that whatever stops it, some categories are whole."""
    return [*_table(declaration, scale), *_curve(declaration, scale)]


def _table(declaration: Declaration, scale: str) -> Iterator[Cell]:
    chosen = declaration.scale(scale)
    for seed in chosen.seeds:
        for category in chosen.categories:
            for method in declaration.methods:
                for objects in chosen.splits:
                    yield Cell(method=method, category=category, objects=objects, seed=seed)


def _curve(declaration: Declaration, scale: str) -> Iterator[Cell]:
    curve = declaration.trials
    if curve is None or scale not in curve.scales:
        return
    for seed in declaration.scale(scale).seeds:
        for category in curve.categories:
            for trials in curve.numbers:
                for objects in curve.splits:
                    yield Cell(method=curve.method, category=category, objects=objects, seed=seed, trials=trials)


def select_cells(declaration: Declaration, scale: str, wanted: Selection) -> list[Cell]:
    """Returns the wanted cells of a scale.

    Raises:
        ConfigurationError: a name is unknown, or no cell of this scale is wanted.
    """
    for what, names, known in (
        ("method", wanted.methods, tuple(declaration.methods)),
        ("category", wanted.categories, tuple(CATEGORIES)),
        ("split of objects", wanted.splits, OBJECT_SPLITS),
    ):
        for name in names:
            require_choice(what, name, known)
    cells = all_cells(declaration, scale)
    chosen = [cell for cell in cells if cell in wanted]
    if not chosen:
        raise ConfigurationError(
            f"The scale {scale!r} has no such cells.",
            got="; ".join(f"{what} {', '.join(map(str, names))}" for what, names in vars(wanted).items() if names),
            allowed=_span(cells),
            hint="adamanip benchmark --list; or a declaration of your own, --config FILE",
        )
    return chosen


def _span(cells: Iterable[Cell]) -> str:
    """What a scale's cells are of, in words."""
    found = list(cells)
    names = {
        "categories": [cell.category for cell in found],
        "splits": [cell.objects for cell in found],
        "seeds": [str(cell.seed) for cell in found],
    }
    return "; ".join(f"{what} {', '.join(dict.fromkeys(values))}" for what, values in names.items())
