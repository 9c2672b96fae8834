"""Leaderboard: self-reported results of methods on the hard tracks, from result files alone."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from lerobot_adamanip.benchmark.declaration import PAPER_TABLE, Declaration, Method, read_declaration
from lerobot_adamanip.benchmark.plan import (
    COLLECT,
    Cell,
    KeyVersions,
    Step,
    all_cells,
    cell_of,
    evaluation_options,
    named_steps,
    options_key,
    plan,
)
from lerobot_adamanip.benchmark.report import scene_options, within
from lerobot_adamanip.catalog import make_object, seen_objects
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.metrics import METRICS, pool
from lerobot_adamanip.evaluation.paired import MAX_COUNTED_TRIES, WITHIN_TRIES
from lerobot_adamanip.evaluation.results import (
    EVALUATE,
    NO_COMMIT,
    CellRun,
    ResultFile,
    ResultRow,
    StepDone,
    read_results,
)
from lerobot_adamanip.evaluation.text_format import markdown_table, percent_text
from lerobot_adamanip.mechanisms import best_tries, make_mechanism
from lerobot_adamanip.util.errors import DatasetError

TRACKS = PAPER_TABLE.with_name("tracks.toml")
SCALES = ("row", "changing", "real_sensors")
"""Scales of `TRACKS` that an entry has all cells of, of one seed."""
SEED = 1000
"""Seed of the trainings of an entry."""
COLUMNS = {
    ("row", "unseen"): "locks in a row",
    ("changing", "unseen"): "a lock that changes",
    ("real_sensors", "unseen"): "D435, unseen objects",
    ("real_sensors", "novel"): "D435, novel objects",
}
"""Scale and split of objects -> title of its column."""
DECLARATION = "declaration.toml"
_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,59}"
REFERENCE = "dp3_adaptive"
"""Method of `TRACKS` whose scenes an entry is evaluated in."""
RULE = f"""An entry is a pull request that adds the folder `results/leaderboard/NAME/`: a declaration, and a result
file of each cell. The numbers are self-reported: a file cannot prove how it was made. Commands, commits and versions
are in it.

1. Copy `lerobot_adamanip/benchmark/tracks.toml` to `results/leaderboard/NAME/{DECLARATION}`.
2. Add a table `[methods.mine]` with `scales = [{", ".join(f'"{name}"' for name in SCALES)}]`
   ([fields](benchmark.md#the-declaration)).
3. In a checkout without changes, run:

```bash
for scale in {" ".join(SCALES)}; do
    adamanip benchmark --config results/leaderboard/NAME/{DECLARATION} --scale $scale --methods mine --seeds {SEED}
    mkdir -p results/leaderboard/NAME/$scale
    cp outputs/benchmark/$scale/cells/mine-*-{SEED}.json results/leaderboard/NAME/$scale
done
python scripts/make_results.py # writes this page; refuses entries with missing cells or changed scenes
```

Rules:

- A method may choose its control, observations, memory, and whether the camera calibrates itself, but not its scenes.
- It may use pretrained weights, data of your own, a teacher that sees the hidden state, or a checkpoint on the Hub
  instead of a training. Say so in `learns_from`.
- It may not learn from unseen or novel objects, and you may not choose it by these scenes.
- The policy may not read the simulator.

To verify an entry, `python scripts/check_entry.py results/leaderboard/NAME --evaluate` trains and evaluates it again,
or evaluates its checkpoint, and compares each cell.
"""


@dataclass(frozen=True)
class LeaderboardEntry:
    """An entry: ``method``'s results, scale -> cell -> result file."""

    method: Method
    results: Mapping[str, Mapping[Cell, ResultFile]]

    @property
    def learns_from(self) -> str:
        """What the method learns from: its own words, or what it declares."""
        if self.method.learns_from or not self.method.is_trained:
            return self.method.learns_from
        return f"the benchmark's demonstrations{' and corrections' if self.method.rounds else ''}"

    @property
    def simulation_version(self) -> int:
        """Simulation version of all results."""
        return next(iter(self.results[SCALES[0]].values())).simulation_version

    def row(self) -> tuple[float, list[str]]:
        """Returns the share that decides the order, and the cells of the table after the name."""
        places: dict[tuple[str, str], list[float]] = {place: [] for place in COLUMNS}
        for scale, results in self.results.items():
            for cell, result in results.items():
                share = within(result.rows[0].metrics)
                places[scale, cell.objects].append((share and share.rate) or 0.0)
        means = [sum(shares) / len(shares) for shares in places.values()]
        pooled = pool(result.rows[0].metrics for results in self.results.values() for result in results.values())
        new = {count: share.rate for count, share in (pooled.untried or {}).items()}
        process = [pooled.repeated.rate if pooled.repeated else None, new.get(1), new.get(2)]
        mean = sum(means) / len(means)
        return mean, [self.learns_from, *map(percent_text, (mean, *means, *process))]


def read_entry(folder: Path) -> LeaderboardEntry:
    """Reads an entry; raises `DatasetError` that says what it lacks, and `ConfigurationError` for its declaration."""
    if not re.fullmatch(_NAME, folder.resolve().name):
        raise DatasetError(
            "An entry of the leaderboard is named by its folder.",
            got=folder.resolve().name,
            allowed="1 to 60 ASCII letters, digits, '.', '_' and '-', a letter or digit first",
            hint="rename the folder",
        )
    declaration = read_declaration(folder / DECLARATION)
    results = {scale: list(read_results(folder / scale).values()) for scale in SCALES}
    if lacking := list(problems(declaration, results)):
        raise DatasetError(
            "Not an entry of the leaderboard.",
            got=f"{folder.name}: {'; '.join(lacking)}",
            allowed="see docs/leaderboard.md",
            hint="repeat the evaluation",
        )
    by_cell = {scale: {cell_of(one): one for one in each} for scale, each in results.items()}
    name = next(iter(by_cell[SCALES[0]])).method
    return LeaderboardEntry(declaration.methods[name], by_cell)


def problems(declaration: Declaration, results: Mapping[str, list[ResultFile]]) -> Iterator[str]:
    """Yields what an entry lacks: a cell, the scenes of all entries, or the origin of its numbers."""
    tracks = read_declaration(TRACKS)
    methods = {one.run.method for each in results.values() for one in each if one.run}
    if len(methods) != 1 or not methods <= declaration.methods.keys():
        yield f"results of {', '.join(sorted(methods)) or 'no method'}, not of one declared method"
        return
    (name,) = methods
    yield from _problems_of_method(declaration, name)
    for scale in SCALES:
        if declaration.scales.get(scale) != tracks.scales[scale]:
            yield f"scale {scale} is not that of {TRACKS.name}"
            continue
        wanted = {cell for cell in all_cells(declaration, scale) if (cell.method, cell.seed) == (name, SEED)}
        if not wanted:
            yield f"{scale}: no cell is declared for {name}"
        found = {cell_of(one): one for one in results[scale] if one.run}
        if foreign := len(results[scale]) - len(found.keys() & wanted):
            yield f"{scale}: {foreign} files that are no result of a declared cell with seed {SEED}"
        if missing := sorted(cell.name for cell in wanted - found.keys()):
            yield f"{scale}: {len(missing)} of {len(wanted)} cells are missing, such as {missing[0]}"
        for cell in sorted(found.keys() & wanted, key=str):
            given = scenes(replace(cell, method=REFERENCE), tracks, scale)
            for problem in _problems_of(found[cell], cell, declaration, scale, given):
                yield f"{scale}, {cell.name}: {problem}"
    every = [one for each in results.values() for one in each]
    if len(versions := {one.simulation_version for one in every}) > 1 or max(versions, default=0) > SIMULATION_VERSION:
        yield f"simulation versions {' and '.join(map(str, sorted(versions)))}; the latest is {SIMULATION_VERSION}"
    if len(versions := {one.run.data_version for one in every if one.run}) > 1:
        yield f"data versions {' and '.join(map(str, sorted(versions)))}"


def _problems_of_method(declaration: Declaration, name: str) -> Iterator[str]:
    """Yields why a method is no policy, or does not say what it learned from."""
    method = declaration.methods[name]
    if method.expert:
        yield "an expert reads the simulator: an entry is a policy"
    if method.learns_from:
        return
    if method.checkpoint:
        yield "learns_from does not say what its checkpoint learned from"
    data = declaration.demonstrations.get(declaration.methods[method.data_of or name].demonstrations)
    if data is not None and data.expert == "static":
        yield "learns_from does not say that its demonstrations are of an expert that sees the hidden state"


def _problems_of(
    result: ResultFile, cell: Cell, declaration: Declaration, scale: str, given: frozenset[tuple[str, str]]
) -> Iterator[str]:
    """Yields what a result lacks, or where it contradicts itself; ``given`` are the scenes of all entries."""
    if any(changed or commit == NO_COMMIT for commit, changed in result.commits):
        yield "made from a commit with changes, or from none"
    run, row = result.run, result.rows[0]
    if run is not None and not run.steps.keys() <= {*run.costs, EVALUATE}:
        yield "without the costs and commits of its steps"
    if run is None or run.options != options_key(cell, declaration, scale):
        yield "made with other options than declared"
        return
    whole = plan(cell, declaration, scale, KeyVersions(result.simulation_version, run.data_version))
    options = evaluation_options(shlex.join(whole.command))
    first, episodes = int(options["--seed"]), row.metrics.success.episodes
    if run.scale != scale or result.command != run.steps[EVALUATE].command or not _has_steps_of(run, whole):
        yield "scale, command or steps are not those of its declaration"
    if result.seeds != (seeds := (first, first + int(options["--eval.n_episodes"]) - 1)):
        yield "seeds {} to {}, not {} to {}".format(*result.seeds, *seeds)
    if row.mechanism_rules != options["--env.mechanism_rules"]:
        yield f"rules {row.mechanism_rules}, not {options['--env.mechanism_rules']}"
    wished = scenes(cell, declaration, scale)
    if (result.scenes, str(episodes)) != (options["--env.split"], options["--eval.n_episodes"]):
        yield f"{episodes} episodes of {result.scenes} scenes"
    if wished != given:
        yield f"evaluated in other scenes ({', '.join(sorted({name for name, _ in wished ^ given}))})"
    if not (row.scene_outcomes and row.scene_tries):
        yield "without the outcome and the failed tries of each scene"
    elif not _has_possible_tries(row):
        yield "repeated and untried are not of its scenes' failed tries"
    elif _exceeds_best_tries(row):
        yield "scenes within the best strategy's tries have more failed tries than those"


def _has_steps_of(run: CellRun, whole: Step) -> bool:
    """Returns whether a run has the steps of a plan.

    Keys are compared by their steps' names: those of a policy hold its package's version, which may not be installed.
    """
    planned = named_steps(whole)
    if list(run.steps) != list(planned):
        return False
    for name, step in planned.items():
        words = _with_names(shlex.split(run.steps[name].command), run.steps)
        declared = _with_names(step.command, planned)
        others = {word.partition("=")[0] for word in words[len(declared) :]}
        if words[: len(declared)] != declared or others - {word.partition("=")[0] for word in step.non_key_options}:
            return False
        if step.kind == COLLECT and run.steps[name].key != step.key:
            return False
    return True


def _with_names(words: Iterable[str], steps: Mapping[str, Step] | Mapping[str, StepDone]) -> list[str]:
    """Returns the words of a command with each step's key replaced by its name."""
    keys = re.compile("|".join(re.escape(step.key) for step in steps.values()))
    names = {step.key: name for name, step in steps.items()}
    return [keys.sub(lambda match: f"<{names[match[0]]}>", word) for word in words]


def _has_possible_tries(row: ResultRow) -> bool:
    """Returns whether the tries after failed ones are as many in both metrics, and at most the failed tries."""
    decisions = row.metrics.repeated.episodes if row.metrics.repeated else 0
    by_count = sum(share.episodes for share in (row.metrics.untried or {}).values())
    is_capped = str(MAX_COUNTED_TRIES) in row.scene_tries
    return decisions == by_count and (is_capped or decisions <= sum(map(int, row.scene_tries)))


def _exceeds_best_tries(row: ResultRow) -> bool:
    """Returns whether a scene counts as within the best strategy's tries, with more failed tries than it ever needs."""
    mechanism = make_mechanism(make_object(seen_objects(row.category)[0]), row.mechanism_rules)
    _, most = best_tries(row.category, row.mechanism_rules, mechanism.hidden_names)
    scenes_within = (pair for pair in zip(row.scene_outcomes, row.scene_tries, strict=True) if pair[0] == WITHIN_TRIES)
    return any(int(tries) > most for _, tries in scenes_within)


def scenes(cell: Cell, declaration: Declaration, scale: str) -> frozenset[tuple[str, str]]:
    """Returns the options of a cell's evaluation that decide its scenes and its limits."""
    command = shlex.join(plan(cell, declaration, scale, KeyVersions(0, 0)).command)
    options = evaluation_options(command)
    return scene_options(command) | {(name, options[name]) for name in ("--seed", "--eval.n_episodes")}


def leaderboard_page(entries: Mapping[str, LeaderboardEntry]) -> str:
    """Returns the leaderboard as Markdown, best entry first; ``entries``: name -> entry."""
    titles = [
        "entry", "learns from", "mean", *COLUMNS.values(), METRICS["repeated"].title, "something new after one",
        "after two",
    ]  # fmt: skip
    rows = {name: (entry.simulation_version, *entry.row()) for name, entry in entries.items()}
    ranked = sorted(rows.items(), key=lambda item: item[1][:2], reverse=True)
    lines = [
        [name if version == SIMULATION_VERSION else f"{name} (simulation version {version})", *cells]
        for name, (version, _, cells) in ranked
    ]
    table = markdown_table(titles, lines) if lines else "No entry yet."
    explanation = f"""Methods compared on three [tracks](tracks.md). The column of a track is the share of episodes
{METRICS["within_best_tries"].title}, a mean over its categories.
`real_sensors` has a column for unseen and one for novel objects. The mean of the four decides the order.
Entries of an earlier simulation version come last and are marked: their scenes differ."""
    return f"# Leaderboard\n\n{explanation}\n\n{table}\n\n## To enter\n\n{RULE}"
