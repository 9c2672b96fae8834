"""Cells of a benchmark: one training of a method, evaluated on one split of objects of one category."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

from lerobot_adamanip.benchmark.declaration import NAME, OBJECT_SPLITS, Declaration
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_adamanip.util.json_fields import choice, integer, optional


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One result of a benchmark.

    Attributes:
        method: name of the method.
        category: category of the objects.
        objects: split of the evaluated objects.
        seed: training seed.
        trials: failed trials in the demonstrations, for the trials curve; None for the table.
    """

    method: Annotated[str, NAME]
    category: Annotated[str, choice(tuple(CATEGORIES))]
    objects: Annotated[str, choice(OBJECT_SPLITS)]
    seed: Annotated[int, integer(0, 2**31)]
    trials: Annotated[int | None, optional(integer(0, 1000))] = None

    @property
    def name(self) -> str:
        """A file name: ``dp3_adaptive-safe-seen-1000``, ``dp3_adaptive-trials3-safe-seen-1000``."""
        trials = () if self.trials is None else (f"trials{self.trials}",)
        return "-".join((self.method, *trials, self.category, self.objects, str(self.seed)))


def all_cells(declaration: Declaration, scale: str) -> list[Cell]:
    """Returns the cells of a scale, category by category, so that an interrupted run has complete categories.

    A method without training has one cell, of the first seed.
    """
    chosen = declaration.scale(scale)
    table = [
        Cell(method=name, category=category, objects=objects, seed=seed)
        for seed in chosen.seeds
        for category in chosen.categories
        for name, method in declaration.methods_of(scale).items()
        for objects in chosen.splits
        if method.is_trained or seed == chosen.seeds[0]
    ]
    return [*table, *_curve(declaration, scale)]


def _curve(declaration: Declaration, scale: str) -> Iterator[Cell]:
    curve = declaration.trials
    if curve is None or scale not in curve.scales:
        return
    for seed in declaration.scale(scale).seeds:
        for category in curve.categories:
            for trials in curve.numbers:
                for objects in curve.splits:
                    yield Cell(method=curve.method, category=category, objects=objects, seed=seed, trials=trials)


def select_cells(
    declaration: Declaration,
    scale: str,
    *,
    methods: tuple[str, ...] = (),
    categories: tuple[str, ...] = (),
    splits: tuple[str, ...] = (),
    seeds: tuple[int, ...] = (),
) -> list[Cell]:
    """Returns the selected cells of a scale; an empty filter selects all.

    Raises:
        ConfigurationError: a name is unknown, or the scale has no matching cell.
    """
    for what, names, known in (
        ("method", methods, tuple(declaration.methods)),
        ("category", categories, tuple(CATEGORIES)),
        ("split of objects", splits, OBJECT_SPLITS),
    ):
        for name in names:
            require_choice(what, name, known)
    wanted = {"method": methods, "category": categories, "objects": splits, "seed": seeds}
    chosen = [
        cell
        for cell in all_cells(declaration, scale)
        if all(getattr(cell, field) in values for field, values in wanted.items() if values)
    ]
    if not chosen:
        there = declaration.scale(scale)
        possible = {"categories": there.categories, "splits": there.splits, "seeds": there.seeds}
        raise ConfigurationError(
            f"The scale {scale!r} has no such cells.",
            got=_listed(wanted),
            allowed=_listed(possible),
            hint="adamanip benchmark --list; or use your own declaration with --config FILE",
        )
    return chosen


def _listed(names: Mapping[str, Iterable[object]]) -> str:
    return "; ".join(f"{what} {', '.join(map(str, each))}" for what, each in names.items() if each)
