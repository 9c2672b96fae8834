"""Report of a benchmark: metrics of each method, pooled over trainings, and missing cells. Pure functions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from lerobot_adamanip.benchmark.cells import Cell, all_cells
from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS, Declaration, Effect, Method
from lerobot_adamanip.benchmark.plan import options_key
from lerobot_adamanip.benchmark.result import OBSERVATION_OPTIONS, CellResult
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.evaluation.metrics import Metrics, pool
from lerobot_adamanip.evaluation.paired import FAILED, MAX_COUNTED_TRIES, PairedDifference, paired_difference
from lerobot_adamanip.evaluation.rates import Rate

FEW_KEY_FRAMES = 15
BUDGETS = (10, FEW_KEY_FRAMES, 25, MAX_KEY_FRAMES)
"""Budget of key frames for the success that reports show."""

type Place = tuple[str, int | None, str, str]
"""Position of a number: method, trials (None in the table), category, split of objects."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A method.

    Attributes:
        name, title: as declared, or from the results of a method that is no longer declared.
        paper: name in the paper; empty to hide the paper's numbers.
        package: distribution that declares it; empty for the declaration itself.
    """

    name: str
    title: str
    paper: str = ""
    package: str = ""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Pooled result of all trainings of a method, in one category and split of objects.

    Attributes:
        numbers: metrics of all their episodes.
        seeds: training seeds with results.
        earlier: whether some results are of an earlier simulation or data version than others, or stale.
        other_options: whether some results were made with other options than declared.
    """

    numbers: Metrics
    seeds: tuple[int, ...]
    earlier: bool
    other_options: bool


@dataclass(frozen=True, kw_only=True)
class BenchmarkReport:
    """Results of one scale.

    Attributes:
        scale: name of the scale.
        note, beside_paper: see `Scale`.
        reference, effects: see `Declaration`.
        rows: methods, declared ones first.
        categories, splits: in table order.
        trials: numbers of failed trials in the curve, in order.
        entries: available numbers by position.
        missing: declared cells without a result.
        unavailable: method -> why it cannot run here; empty if not checked.
        results: all results of the report.
    """

    scale: str
    note: str
    beside_paper: bool
    reference: str
    effects: tuple[Effect, ...]
    rows: tuple[Row, ...]
    categories: tuple[str, ...]
    splits: tuple[str, ...]
    trials: tuple[int, ...]
    entries: Mapping[Place, Entry]
    missing: tuple[Cell, ...]
    unavailable: Mapping[str, str]
    results: tuple[CellResult, ...]

    def entry(self, method: str, category: str, objects: str, trials: int | None = None) -> Entry | None:
        """Returns the entry at a position; None if there is none."""
        return self.entries.get((method, trials, category, objects))

    @property
    def scenes(self) -> str:
        """Split of the scenes; several are joined by ``and``."""
        return " and ".join(sorted({result.scenes for result in self.results}))

    @property
    def rows_with_results(self) -> tuple[Row, ...]:
        """Methods that have results; tables and plots show them."""
        there = {place[0] for place in self.entries if place[1] is None}
        return tuple(row for row in self.rows if row.name in there)

    @property
    def curves(self) -> list[tuple[str, str, str]]:
        """Method, category and split of objects of each trials curve."""
        return sorted({(place[0], place[2], place[3]) for place in self.entries if place[1] is not None})

    @property
    def categories_with_results(self) -> tuple[str, ...]:
        """Categories with results."""
        there = {place[2] for place in self.entries if place[1] is None}
        return tuple(category for category in self.categories if category in there)

    def mean(
        self, method: str, objects: str, share: Callable[[Metrics], Rate | None] = lambda numbers: numbers.success
    ) -> float | None:
        """Returns the mean of a method's rates over the categories, equally weighted, each over all its trainings.

        ``share`` takes metrics to a rate, by default the success. None if a category or its rate is missing.
        """
        found = self.numbers(method, self.categories, (objects,))
        rates = [share(each) for each in found]
        if len(rates) < len(self.categories) or None in rates:
            return None
        return sum(each.rate or 0.0 for each in rates if each is not None) / len(rates)

    def trainings(self, method: str, objects: str) -> str:
        """Returns the number of trainings behind a mean: one number, or ``1 to 3``."""
        entries = [self.entry(method, category, objects) for category in self.categories]
        return least_to_most(len(each.seeds) for each in entries if each is not None)

    def paired(
        self, methods: tuple[str, str], categories: Sequence[str], objects: str, min_outcome: str
    ) -> PairedDifference | None:
        """Returns the first method's share of scenes with at least an outcome minus the second's, in the same scenes.

        Uses the trainings that both have in all of these categories, with objects of one split; None if there are none,
        or if their scenes differ. Outcomes: see `paired_difference`.
        """
        table = [each for each in self.results if each.cell.objects == objects and each.cell.trials is None]
        found = {(each.cell.method, each.cell.category, each.cell.seed): each for each in table if each.outcomes}
        pairs = {}
        for seed in sorted({seed for _, _, seed in found}):
            both = [[found.get((name, each, seed)) for name in methods] for each in categories]
            if all(one and other and self.scenes_of(one) == self.scenes_of(other) for one, other in both):
                pairs[seed] = [(one.outcomes, other.outcomes) for one, other in both if one and other]
        lengths = {len(first) for each in pairs.values() for first, _ in each}
        return paired_difference(pairs, min_outcome) if len(lengths) == 1 else None

    def scenes_of(self, result: CellResult) -> tuple[object, ...]:
        """Returns all that decides the scenes of a result."""
        given = result.evaluation_options.items()
        options = {each for each in given if each[0].startswith("--env.") and each[0] not in OBSERVATION_OPTIONS}
        return result.simulation_version, result.scene_seeds, len(result.outcomes), frozenset(options)

    def opened_with(self, method: str, objects: str) -> list[float]:
        """Returns the share of scenes opened with at most 0, 1, ... `MAX_COUNTED_TRIES` - 1 failed tries.

        The mean over the categories, equally weighted; empty if one is missing, or for results of earlier versions.
        """
        shares = []
        for category in self.categories:
            place = method, None, category, objects
            results = [each for each in self.results if _place(each.cell) == place]
            scenes = [pair for each in results for pair in zip(each.outcomes, each.failed_tries, strict=False)]
            tries = [MAX_COUNTED_TRIES if outcome == FAILED else int(count) for outcome, count in scenes]
            if not tries:
                return []
            shares.append([sum(each <= number for each in tries) / len(tries) for number in range(MAX_COUNTED_TRIES)])
        return [sum(column) / len(shares) for column in zip(*shares, strict=True)]

    def numbers(self, method: str, categories: Iterable[str], splits: Iterable[str]) -> list[Metrics]:
        """Returns the available metrics of a method in these categories and splits of objects."""
        places = itertools.product(categories, splits)
        return [found.numbers for place in places if (found := self.entry(method, *place)) is not None]

    def csv_rows(self) -> Iterator[tuple[dict[str, object], Metrics]]:
        """Yields labels and metrics of each entry, for `csv_table`."""
        versions = {_place(result.cell): result.simulation_version for result in self.results}
        for place, entry in self.entries.items():
            labels = dict(zip(("subject", "trials", "category", "objects"), place, strict=True))
            made = {"result": f"benchmark/{self.scale}", "simulation_version": versions[place]}
            yield {**made, **labels, "trainings": len(entry.seeds)}, entry.numbers


def least_to_most(numbers: Iterable[int]) -> str:
    """Returns the range of some numbers as text: ``1 to 3``, one number if they are equal, empty without any."""
    ordered = sorted(numbers)
    return " to ".join(map(str, dict.fromkeys((*ordered[:1], *ordered[-1:]))))


def make_report(
    results: Sequence[CellResult],
    declaration: Declaration,
    scale: str,
    *,
    unavailable: Mapping[str, str] | None = None,
    stale: Collection[Cell] = (),
) -> BenchmarkReport:
    """Builds a report from result files.

    Args:
        results: of any cells, declared or not.
        declaration: the benchmark.
        scale: name of the scale.
        unavailable: see `BenchmarkReport`.
        stale: cells whose key has changed, for instance by another version of a policy's package.
    """
    declared, cells, there = declaration.scale(scale), all_cells(declaration, scale), {each.cell for each in results}
    other_options = _with_other_options(results, declaration, scale)
    newest = max(map(_versions, results), default=None)
    earlier = {each.cell for each in results if _versions(each) != newest} | (set(stale) - other_options)
    places = [_place(cell) for cell in (*cells, *there)]
    return BenchmarkReport(
        scale=scale,
        note=declared.note,
        beside_paper=declared.beside_paper,
        reference=declaration.reference,
        effects=declaration.effects,
        rows=tuple(_rows(declaration.methods_of(scale), declared.beside_paper, results)),
        categories=_in_order(CATEGORIES, (place[2] for place in places if place[1] is None)),
        splits=_in_order(OBJECT_SPLITS, (place[3] for place in places if place[1] is None)),
        trials=tuple(sorted({trials for _, trials, _, _ in places if trials is not None})),
        entries=_entries(results, earlier, other_options),
        missing=tuple(cell for cell in cells if cell not in there),
        unavailable=dict(unavailable or {}),
        results=tuple(results),
    )


def _versions(result: CellResult) -> tuple[int, int]:
    return result.simulation_version, result.data_version


def _with_other_options(results: Iterable[CellResult], declaration: Declaration, scale: str) -> set[Cell]:
    declared = set(all_cells(declaration, scale))
    measured = [each for each in results if each.cell in declared]
    return {each.cell for each in measured if each.options != options_key(each.cell, declaration, scale)}


def _entries(
    results: Iterable[CellResult], earlier: Collection[Cell], other_options: Collection[Cell]
) -> dict[Place, Entry]:
    found: dict[Place, list[CellResult]] = {}
    for result in results:
        found.setdefault(_place(result.cell), []).append(result)
    return {
        place: Entry(
            numbers=pool(each.numbers for each in several),
            seeds=tuple(sorted(each.cell.seed for each in several)),
            earlier=any(each.cell in earlier for each in several),
            other_options=any(each.cell in other_options for each in several),
        )
        for place, several in found.items()
    }


def _place(cell: Cell) -> Place:
    return cell.method, cell.trials, cell.category, cell.objects


def _rows(methods: Mapping[str, Method], beside_paper: bool, results: Iterable[CellResult]) -> Iterable[Row]:
    for name, method in methods.items():
        yield Row(name=name, title=method.title, paper=method.paper if beside_paper else "", package=method.package)
    others = {
        result.cell.method: Row(name=result.cell.method, title=result.title, package=result.package)
        for result in results
        if result.cell.method not in methods
    }
    yield from others.values()


def _in_order(names: Iterable[str], chosen: Iterable[str]) -> tuple[str, ...]:
    wanted = set(chosen)
    return tuple(name for name in names if name in wanted)
