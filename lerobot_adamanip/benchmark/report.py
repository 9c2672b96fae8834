"""Report of a benchmark: metrics of each method, pooled over trainings, by category and objects. Pure functions."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS, Declaration, Effect
from lerobot_adamanip.benchmark.plan import CHOSEN, TRAIN, Cell, all_cells, cell_of, evaluation_options, options_key
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.control import DENSE
from lerobot_adamanip.contract.sensing import EXACT
from lerobot_adamanip.evaluation.metrics import Metrics, pool
from lerobot_adamanip.evaluation.paired import FAILED, MAX_COUNTED_TRIES, PairedDifference, paired_difference
from lerobot_adamanip.evaluation.rates import Mean, Rate, rate
from lerobot_adamanip.evaluation.results import CellRun, ResultFile, TrainingLog

KEY_FRAME_BUDGETS = (10, 15, 25)
"""Numbers of key frames, for the columns of success within them in the CSV file."""
EARLIER, OTHER_OPTIONS = "†", "‡"
MARKS = {
    EARLIER: "of an earlier simulation or data version than the others; not to be compared with them",
    OTHER_OPTIONS: "of other options than declared now",
}

type Place = tuple[str, str, str]
"""Position of a number: method, category, split of objects."""
type Share = Callable[[Metrics], Rate | None]


def opened(metrics: Metrics) -> Rate | None:
    """Returns the success rate."""
    return metrics.success


def within(metrics: Metrics) -> Rate | None:
    """Returns the share opened within the best strategy's tries."""
    return metrics.within_best_tries


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Pooled result of all trainings of a method, in one category and split of objects.

    Attributes:
        metrics: metrics of all their episodes.
        results: the results.
        marks: `EARLIER` and `OTHER_OPTIONS`, if they apply to one of them.
    """

    metrics: Metrics
    results: tuple[ResultFile, ...]
    marks: str


@dataclass(frozen=True, kw_only=True)
class BenchmarkReport:
    """Results of one scale.

    Attributes:
        scale: name of the scale.
        note, beside_paper: see `Scale`.
        titles: method -> title with the package that declares it; declared methods first, then others with results.
        paper: method -> name in the paper; empty to hide the paper's numbers.
        effects: declared comparisons, then those of the reference with each other method.
        categories, splits: in table order; splits of objects with results, if there are any.
        entries: available numbers by position.
        missing: declared cells without a result.
        unavailable: method -> why it cannot run here; empty if not checked.
        results: all results of the report, with their `CellRun`.
    """

    scale: str
    note: str
    beside_paper: bool
    titles: Mapping[str, str]
    paper: Mapping[str, str]
    effects: tuple[Effect, ...]
    categories: tuple[str, ...]
    splits: tuple[str, ...]
    entries: Mapping[Place, Entry]
    missing: tuple[Cell, ...]
    unavailable: Mapping[str, str]
    results: tuple[ResultFile, ...]

    @property
    def scenes(self) -> str:
        """Split of the scenes; several are joined by ``and``."""
        return " and ".join(sorted({str(result.scenes) for result in self.results}))

    @property
    def methods(self) -> list[str]:
        """Methods that have results; tables and plots show them."""
        return [name for name in self.titles if any(place[0] == name for place in self.entries)]

    @property
    def categories_with_results(self) -> list[str]:
        """Categories with results."""
        return [category for category in self.categories if any(place[1] == category for place in self.entries)]

    def of(self, method: str, objects: str) -> list[Entry]:
        """Returns the available entries of a method, one per category."""
        places = [(method, category, objects) for category in self.categories]
        return [self.entries[place] for place in places if place in self.entries]

    def mean(self, method: str, objects: str, share: Share = opened) -> float | None:
        """Returns the mean of a method's rates over the categories, equally weighted, each over all its trainings.

        None if a category or its rate is missing.
        """
        rates = [share(entry.metrics) for entry in self.of(method, objects)]
        if len(rates) < len(self.categories) or None in rates:
            return None
        return sum(rate.rate or 0.0 for rate in rates if rate is not None) / len(rates)

    def trainings(self, method: str, objects: str) -> str:
        """Returns the number of trainings behind a mean: one number, or ``1 to 3``."""
        numbers = sorted(len(entry.results) for entry in self.of(method, objects))
        return " to ".join(map(str, dict.fromkeys((*numbers[:1], *numbers[-1:]))))

    def paired(
        self, methods: tuple[str, str], categories: Sequence[str], objects: str, min_outcome: str
    ) -> PairedDifference | None:
        """Returns the first method's share of scenes with at least an outcome minus the second's, in the same scenes.

        Uses the trainings that both have in all of these categories, with objects of one split; None if there are none,
        or if their scenes differ. A method without training is compared with each training of the other. Outcomes: see
        `paired_difference`.
        """
        kept = {cell_of(result): result for result in self.results if result.rows[0].scene_outcomes}
        trained = {cell for cell, result in kept.items() if result.run and TRAIN in result.run.steps}
        seeds = {cell.seed for cell in trained if cell.method in methods}
        kept |= {replace(cell, seed=seed): kept[cell] for cell in kept.keys() - trained for seed in seeds}
        pairs, repeats = {}, 1
        for seed in sorted({cell.seed for cell in kept}):
            cells = [
                [Cell(method=name, category=category, objects=objects, seed=seed) for name in methods]
                for category in categories
            ]
            both = [(kept.get(first), kept.get(second)) for first, second in cells]
            if all(one and other and scenes_of(one) == scenes_of(other) for one, other in both):
                rows = [(one.rows[0], other.rows[0]) for one, other in both if one and other]
                pairs[seed] = [(one.scene_outcomes, other.scene_outcomes) for one, other in rows]
                repeats = next((_repeats(one) for one, _ in both if one), 1)
        lengths = {len(first) for several in pairs.values() for first, _ in several}
        return paired_difference(pairs, min_outcome, repeats) if len(lengths) == 1 else None

    def opened_with(self, method: str, objects: str) -> list[float]:
        """Returns the share of scenes opened with at most 0, 1, ... `MAX_COUNTED_TRIES` - 1 failed tries.

        The mean over the categories, equally weighted; empty if one is missing, or for results of earlier versions.
        """
        shares = []
        for entry in self.of(method, objects):
            rows = [result.rows[0] for result in entry.results]
            scenes = [pair for row in rows for pair in zip(row.scene_outcomes, row.scene_tries, strict=False)]
            tries = [MAX_COUNTED_TRIES if outcome == FAILED else int(count) for outcome, count in scenes]
            if tries:
                shares.append(
                    [sum(count <= limit for count in tries) / len(tries) for limit in range(MAX_COUNTED_TRIES)]
                )
        if len(shares) < len(self.categories):
            return []
        return [sum(column) / len(shares) for column in zip(*shares, strict=True)]

    def by_turn(self, method: str, objects: str) -> list[tuple[Rate, Mean]]:
        """Returns the success, and the failed tries of a success, of each time that a scene is played in a row.

        Pooled over the categories; a scene's failed tries count as at most `MAX_COUNTED_TRIES`, and leave out
        the moved keys of unlocked objects, which `scene_tries` lacks. Empty if no scene is played again.
        """
        turns: dict[int, list[str]] = {}
        for result in (result for entry in self.of(method, objects) for result in entry.results):
            row, repeats = result.rows[0], _repeats(result)
            tries = [
                "" if pair[0] == FAILED else pair[1] for pair in zip(row.scene_outcomes, row.scene_tries, strict=False)
            ]
            for turn in range(repeats if repeats > 1 else 0):
                turns.setdefault(turn, []).extend(tries[turn::repeats])
        opened = {turn: [int(each) for each in tries if each] for turn, tries in turns.items()}
        return [(rate(len(some), len(turns[turn])), Mean(sum(some), len(some))) for turn, some in opened.items()]

    def runs_of(self, method: str) -> list[CellRun]:
        """Returns a `CellRun` of each last training of a method, which several results may share."""
        runs = [result.run for result in self.results if result.run is not None and result.run.method == method]
        names = [last_training(run) for run in runs]
        return list(
            {run.steps[name].key if name else id(run): run for run, name in zip(runs, names, strict=True)}.values()
        )

    def mean_losses(self, method: str) -> list[float]:
        """Returns the loss curve of a method's last training, relative to its first value.

        It has one value per equal part of the training: the geometric mean over its cells. Empty without a log.
        """
        logs = [log for log in last_trainings(self.runs_of(method)) if min(log.losses) > 0]
        parts = zip(*([loss / log.losses[0] for loss in log.losses] for log in logs), strict=True)
        return [statistics.geometric_mean(part) for part in parts]

    def csv_lines(self) -> Iterator[dict[str, object]]:
        """Yields labels and all metrics of each entry."""
        for (method, category, objects), entry in self.entries.items():
            first = entry.results[0]
            origin = {"result": f"benchmark/{self.scale}", "simulation_version": first.simulation_version}
            labels = {"subject": method, "mechanism_rules": first.rows[0].mechanism_rules, "category": category}
            counts = {k: entry.metrics.opened_within(k).count for k in KEY_FRAME_BUDGETS}
            is_dense = evaluation_options(first.command).get("--env.control") == DENSE  # its rows are no key frames
            within = {f"within_{k}_key_frames": "" if is_dense else count for k, count in counts.items()}
            trainings = {"objects": objects, "trainings": len(entry.results)}
            yield {**origin, **labels, **trainings, **entry.metrics.columns(), **within}


def last_trainings(runs: Iterable[CellRun]) -> list[TrainingLog]:
    """Returns the logs of the last training of each run that has one."""
    return [run.trainings[name] for run in runs if (name := last_training(run)) in run.trainings]


def last_training(run: CellRun) -> str:
    """Returns the name of a run's last training step; empty if it has none."""
    return next((name for name, _ in reversed(list(run.options_of(TRAIN)))), "")


def scenes_of(result: ResultFile) -> tuple[object, ...]:
    """Returns the version, seeds and options that decide the scenes of a result."""
    deciding = scene_options(result.command)
    return result.simulation_version, result.seeds, len(result.rows[0].scene_outcomes), deciding


def _repeats(result: ResultFile) -> int:
    return int(evaluation_options(result.command).get("--env.repeats", 1))


def scene_options(command: str) -> frozenset[tuple[str, str]]:
    """Returns the options of an evaluation's environment, name and value, that decide its scenes."""
    options = {"--env.sensing": EXACT, **evaluation_options(command)}.items()
    # `--env=...` replaces the whole environment, so it decides its scenes too.
    return frozenset(
        pair for pair in options if pair[0].partition(".")[0] == "--env" and not pair[0].startswith(CHOSEN)
    )


def make_report(
    results: Iterable[ResultFile],
    declaration: Declaration,
    scale: str,
    *,
    unavailable: Mapping[str, str] | None = None,
    stale: Collection[Cell] = (),
) -> BenchmarkReport:
    """Builds a report from result files.

    Args:
        results: results of any cells, declared or not.
        declaration: the benchmark.
        scale: name of the scale.
        unavailable: see `BenchmarkReport`.
        stale: cells whose key has changed, for instance by another version of a policy's package.
    """
    by_cell = {cell_of(result): result for result in results}
    declared, cells, methods = declaration.scale(scale), all_cells(declaration, scale), declaration.methods_of(scale)
    titles = {name: _title(method.title, method.package) for name, method in methods.items()}
    for cell, result in by_cell.items():
        titles.setdefault(cell.method, _title(result.rows[0].subject, result.run.package if result.run else ""))
    shared = {title for title, count in Counter(titles.values()).items() if count > 1}
    titles = {name: f"{title} ({name})" if title in shared else title for name, title in titles.items()}
    places = [(cell.category, cell.objects) for cell in (*cells, *by_cell)]
    compared = {(effect.method, effect.without) for effect in declaration.effects if not effect.categories}
    others = [
        Effect(title=f"{titles[declaration.reference]} less {title}", method=declaration.reference, without=name)
        for name, title in titles.items()
        if declaration.reference in titles and name != declaration.reference
        if (declaration.reference, name) not in compared
    ]
    return BenchmarkReport(
        scale=scale,
        note=declared.note,
        beside_paper=declared.beside_paper,
        titles=titles,
        paper={name: methods[name].paper if name in methods and declared.beside_paper else "" for name in titles},
        effects=(*declaration.effects, *others),
        categories=tuple(name for name in CATEGORIES if any(category == name for category, _ in places)),
        splits=tuple(name for name in OBJECT_SPLITS if any(cell.objects == name for cell in by_cell or cells)),
        entries=_entries(by_cell, declaration, scale, stale),
        missing=tuple(cell for cell in cells if cell not in by_cell),
        unavailable=dict(unavailable or {}),
        results=tuple(by_cell.values()),
    )


def _title(title: str, package: str) -> str:
    return f"{title} ({package})" if package else title


def _entries(
    results: Mapping[Cell, ResultFile], declaration: Declaration, scale: str, stale: Collection[Cell]
) -> dict[Place, Entry]:
    declared = set(all_cells(declaration, scale))
    versions = {cell: (one.simulation_version, one.run.data_version if one.run else 0) for cell, one in results.items()}
    newest = max(versions.values(), default=None)
    marks, places = dict[Cell, set[str]](), dict[Place, list[Cell]]()
    for cell, result in results.items():
        is_declared = cell in declared or cell.method in declaration.methods_of(scale)
        options = options_key(cell, declaration, scale) if is_declared else None
        has_other_options = result.run is not None and options not in (None, result.run.options)
        is_earlier = versions[cell] != newest or (cell in stale and not has_other_options)
        marks[cell] = {*([EARLIER] if is_earlier else []), *([OTHER_OPTIONS] if has_other_options else [])}
        places.setdefault((cell.method, cell.category, cell.objects), []).append(cell)
    return {
        place: Entry(
            metrics=pool(results[cell].rows[0].metrics for cell in cells),
            results=tuple(results[cell] for cell in cells),
            marks="".join(mark for mark in MARKS if any(mark in marks[cell] for cell in cells)),
        )
        for place, cells in places.items()
    }
