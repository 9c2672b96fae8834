"""Result files: measured numbers with their provenance.

A file in ``results/``, of `adamanip report --out` or of a benchmark's cell is one JSON object of the same form, a
`ResultFile`. `scripts/make_results.py` turns those of this repository into the tables of the documents.
"""

from __future__ import annotations

import itertools
import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.versions import SIMULATION_VERSION, joined_versions
from lerobot_adamanip.evaluation.metrics import Metrics, measure
from lerobot_adamanip.evaluation.paired import FAILED, OPENED, WITHIN_TRIES, failed_tries, outcomes
from lerobot_adamanip.evaluation.provenance import (
    HASH,
    MACHINE,
    VERSION_NUMBER,
    Origin,
    machine_class,
    present_origin,
)
from lerobot_adamanip.evaluation.rates import LINE
from lerobot_adamanip.evaluation.record import LIMITS, EpisodeRecord, mixed_settings, without_repeats
from lerobot_adamanip.evaluation.report import OBJECT_SPLITS
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.files import write_atomically
from lerobot_adamanip.util.json_fields import (
    choice,
    flag,
    integer,
    listing,
    mapping,
    number,
    optional,
    read,
    record,
    text,
)
from lerobot_adamanip.util.machine_paths import MACHINE_PATH

KINDS = ("expert", "policy")
EVALUATE = "evaluate"
"""Name of a benchmark's last step."""
NAME = text(r"[a-z][a-z0-9_]{0,39}", "a name of small letters, digits and _")
NO_COMMIT = "none"
LOGGED = 20
"""Number of values of the loss in a training's log."""
_LATEST = LOGGED // 5
_PRIVATE_PATH = re.compile(MACHINE_PATH + "|://|@")
"""Content that a published command must not have: local paths, addresses, users."""
_COMMAND = text(r"[^\r\n`]{1,4000}", "one line without backquotes")
_STEP_NAME = text(r"[a-z]{1,20}(_\d+)?", "the name of a step")


@dataclass(frozen=True)
class ResultRow:
    """Result of one subject, set of mechanism rules, category and split of objects.

    Attributes:
        subject: expert or policy, as in tables: ``adaptive``, ``dp3_adaptive, adaptive demonstrations``.
        mechanism_rules: see `MECHANISM_RULES`; also those of earlier versions.
        category: category, for instance ``safe``.
        objects: one of `OBJECT_SPLITS`.
        metrics: metrics of these episodes; failed and unreachable ones count too.
        scene_outcomes, scene_tries: outcome and failed tries of each scene, see `lerobot_adamanip.evaluation.paired`;
            empty if not kept.
    """

    subject: Annotated[str, LINE]
    mechanism_rules: Annotated[str, text(r"[a-z_]{1,30}", "a name of mechanism rules")]
    category: Annotated[str, choice(tuple(CATEGORIES))]
    objects: Annotated[str, choice(OBJECT_SPLITS)]
    metrics: Annotated[Metrics, Metrics.from_json]
    scene_outcomes: Annotated[str, text(r"[012]{0,100000}", "a digit 0, 1 or 2 for each scene")] = ""
    scene_tries: Annotated[str, text(r"[0-9]{0,100000}", "a digit for each scene")] = ""

    @classmethod
    def of(
        cls, subject: str, mechanism_rules: str, category: str, objects: str, records: Sequence[EpisodeRecord]
    ) -> ResultRow:
        """Returns the row of unique episodes."""
        scenes = outcomes(records), failed_tries(records)
        return cls(subject, mechanism_rules, category, objects, measure(records), *scenes)

    def to_json(self) -> dict[str, Any]:
        """Returns a flat JSON-serialisable dictionary."""
        labels = {name: value for name, value in vars(self).items() if name != "metrics"}
        return {**labels, **self.metrics.to_json()}

    @classmethod
    def from_json(cls, name: str, content: object) -> ResultRow:
        """Returns the row in decoded JSON; raises ValueError that names the invalid field."""
        if not isinstance(content, Mapping):
            raise ValueError(f"{name} is not a row")
        labels = [item.name for item in fields(cls) if item.name in content]
        metrics = {key: value for key, value in content.items() if key not in labels}
        row = record(cls)(name, {**{key: content[key] for key in labels}, "metrics": metrics})
        _check_outcomes(row)
        return row


def _check_outcomes(row: ResultRow) -> None:
    """Raises ValueError if the scenes' outcomes contradict the metrics."""
    success, within = row.metrics.success, row.metrics.within_best_tries
    lengths = {len(digits) for digits in (row.scene_outcomes, row.scene_tries) if digits}
    if lengths - {success.episodes}:
        raise ValueError(f"scene_outcomes and scene_tries are not of {success.episodes} episodes")
    opened = len(row.scene_outcomes) - row.scene_outcomes.count(FAILED)
    counts = (success.count, within.count if within else 0)
    if row.scene_outcomes and (opened, row.scene_outcomes.count(WITHIN_TRIES)) != counts:
        raise ValueError("scene_outcomes are not those of the metrics")
    tries = [(outcome, int(count)) for outcome, count in zip(row.scene_outcomes, row.scene_tries, strict=False)]
    necessary = max((count for outcome, count in tries if outcome == WITHIN_TRIES), default=0)
    if any(outcome == OPENED and count <= necessary for outcome, count in tries):
        raise ValueError("scene_outcomes contradict scene_tries")


@dataclass(frozen=True, kw_only=True)
class StepDone:
    """A finished step behind a result: the key of its product, and its command as typed in the benchmark's folder."""

    key: Annotated[str, HASH]
    command: Annotated[str, _COMMAND]


@dataclass(frozen=True)
class StepCost:
    """Cost of a step, shared by all cells that need it.

    Attributes:
        begun: number of starts; more than one after interruptions.
        seconds: duration of the last run.
        machine: see `machine_class`.
        versions: installed versions at its end; empty in results before simulation version 3.
        commit: commit at its end; `NO_COMMIT` outside a repository, empty in results that do not hold it.
        changed: whether tracked files differed from it at its begin or end, or the commit changed in between.
    """

    begun: Annotated[int, integer(1, 10**6)]
    seconds: Annotated[float, number(0, 10**9)]
    machine: Annotated[Mapping[str, int | bool], MACHINE]
    versions: Annotated[Mapping[str, str], mapping(LINE, LINE, 30)] = field(default_factory=dict)
    commit: Annotated[str, text(rf"|{NO_COMMIT}|[0-9a-f]{{8,64}}", "a hash, none, or an empty text")] = ""
    changed: Annotated[bool, flag] = False


@dataclass(frozen=True, kw_only=True)
class TrainingLog:
    """A training that ran without an interruption.

    Attributes:
        parameters: number of learnable parameters.
        losses: mean training loss of each of `LOGGED` equal parts of the training, in order.
    """

    parameters: Annotated[int, integer(0, 10**12)]
    losses: Annotated[tuple[float, ...], listing(number(-1e12, 1e12), LOGGED, LOGGED)]

    @property
    def change(self) -> float:
        """Relative change of the loss from the fourth fifth of the training to the last fifth; negative if it falls."""
        before, latest = self.losses[-2 * _LATEST : -_LATEST], self.losses[-_LATEST:]
        return sum(latest) / sum(before) - 1 if sum(before) else 0.0


@dataclass(frozen=True, kw_only=True)
class CellRun:
    """Run of `adamanip benchmark` behind a result.

    Attributes:
        scale, method: names in the declaration.
        package: distribution that declared the method; empty for the declaration itself.
        seed: seed of the training.
        options: key of the declared options, from `lerobot_adamanip.benchmark.plan.options_key`.
        data_version: see `lerobot_adamanip.contract.versions`.
        steps: by name, in order: ``collect``, ``train``, ``evaluate``; repeated kinds are ``train_2`` and so on.
        trainings: name of step -> log of the training; without those that were interrupted.
        costs: name of step -> cost; differs in every run.
    """

    scale: Annotated[str, NAME]
    method: Annotated[str, NAME]
    package: Annotated[str, text(r"[\w.-]{0,100}", "a distribution's name, or an empty text")]
    seed: Annotated[int, integer(0, 2**31)]
    options: Annotated[str, HASH]
    data_version: Annotated[int, VERSION_NUMBER]
    steps: Annotated[Mapping[str, StepDone], mapping(_STEP_NAME, record(StepDone), 100)]
    trainings: Annotated[Mapping[str, TrainingLog], mapping(_STEP_NAME, record(TrainingLog), 100)]
    costs: Annotated[Mapping[str, StepCost], mapping(_STEP_NAME, record(StepCost), 100)]

    @property
    def key(self) -> str:
        """Cache key of everything that affects the result."""
        return self.steps[EVALUATE].key

    def options_of(self, kind: str) -> Iterator[tuple[str, dict[str, str]]]:
        """Yields name and options of the steps of a kind."""
        for name, step in self.steps.items():
            if name.partition("_")[0] == kind:
                yield name, command_options(step.command)


@dataclass(frozen=True, kw_only=True)
class ResultFile(Origin):
    """A measurement.

    `adamanip report` takes version, versions and simulation version from the log, which holds no commit and no machine:
    both are those of the report then.

    Attributes:
        kind: one of `KINDS`.
        title: description in one line.
        command: measuring command, as typed in the repository's root or in the benchmark's folder.
        simulation_version: simulation version of the episodes.
        machine: ``cores`` and ``gpu``, without a name.
        scenes: split of the scenes. ``seeds``: the first and the last.
        seconds: duration; None if not measured.
        rows: measured numbers; a benchmark's cell has one row.
        run: run of a benchmark; None for other results.
    """

    kind: Annotated[str, choice(KINDS)]
    title: Annotated[str, LINE]
    command: Annotated[str, _COMMAND]
    simulation_version: Annotated[int, VERSION_NUMBER]
    machine: Annotated[Mapping[str, int | bool], MACHINE]
    scenes: Annotated[str | None, optional(choice(("test", "validation", "train")))]
    seeds: Annotated[tuple[int, int], listing(integer(0, 2**31), 2, 2)]
    seconds: Annotated[float | None, optional(number(0, 10**9))]
    rows: Annotated[tuple[ResultRow, ...], listing(ResultRow.from_json, 1, 10_000)]
    run: Annotated[CellRun | None, optional(record(CellRun))] = None
    schema: Annotated[int, integer(1, 1)] = 1

    @property
    def all_versions(self) -> dict[str, str]:
        """Installed versions of all steps, by name; different ones are joined by ``and``."""
        costs = self.run.costs.values() if self.run else ()
        return joined_versions([self.versions, *(cost.versions for cost in costs)])

    @property
    def commits(self) -> set[tuple[str, bool]]:
        """Commits of the result and of its steps, each with whether tracked files differed from it."""
        steps = {(cost.commit, cost.changed) for cost in (self.run.costs.values() if self.run else ()) if cost.commit}
        return {(self.commit or NO_COMMIT, self.changed), *steps}

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-serialisable dictionary."""
        run = None if self.run is None else asdict(self.run)
        return {**vars(self), "rows": [row.to_json() for row in self.rows], "run": run}


def command_options(command: str) -> dict[str, str]:
    """Returns the options of a command, name -> value, empty if it has none.

    LeRobot's may be ``--NAME=VALUE`` or ``--NAME VALUE``. The word after one of `adamanip`'s switches is no value.
    """
    words, options = shlex.split(command), dict[str, str]()
    for word, following in itertools.zip_longest(words, words[1:], fillvalue="--"):
        name, equals, value = word.partition("=")
        if name.startswith("--"):
            is_value = not equals and not following.startswith("--") and words[0] != "adamanip"
            options[name] = following if is_value else value
    return options


def check_command(command: str) -> str:
    """Returns a command that can be published; raises `ConfigurationError` if it contains a local path."""
    if _PRIVATE_PATH.search(command):
        raise ConfigurationError(
            "A command in a result file must run elsewhere.",
            got=command,
            allowed="paths relative to the repository's root, no addresses, no users",
            hint="--command 'lerobot-eval --policy.path=outputs/train/... '",
        )
    return command


def rows_of_records(records: Sequence[EpisodeRecord], subject: str) -> list[ResultRow]:
    """Returns a row for each set of mechanism rules, category and split of objects in an evaluation."""
    groups: dict[tuple[str, str, str], list[EpisodeRecord]] = {}
    for one in without_repeats(records):
        key = (one.provenance.mechanism_rules, one.category, one.object_split or "external")
        groups.setdefault(key, []).append(one)

    def order(key: tuple[str, str, str]) -> tuple[str, int, int]:
        return key[0], tuple(CATEGORIES).index(key[1]), OBJECT_SPLITS.index(key[2])

    return [ResultRow.of(subject, *key, groups[key]) for key in sorted(groups, key=order)]


def make_result(
    rows: Iterable[ResultRow],
    *,
    kind: str,
    title: str,
    command: str,
    seeds: Sequence[int],
    scenes: str | None,
    seconds: float | None = None,
    simulation_version: int = SIMULATION_VERSION,
    **measured: Any,
) -> ResultFile:
    """Returns a result with its origin and machine filled in.

    Args:
        rows: one or more rows.
        kind: one of `KINDS`.
        title: one line.
        command: as typed; raises `ConfigurationError` if it contains a local path.
        seeds: seeds of the episodes.
        scenes: split of the scenes.
        seconds: duration.
        simulation_version: simulation version of the episodes, if they were not simulated now.
        **measured: fields of `Origin` that are known from then.
    """
    return ResultFile(
        kind=kind,
        title=title,
        command=check_command(command),
        simulation_version=simulation_version,
        **{**asdict(present_origin()), **measured},
        machine=machine_class(),
        scenes=scenes,
        seeds=(min(seeds), max(seeds)),
        seconds=None if seconds is None else round(seconds, 1),
        rows=tuple(rows),
    )


def policy_result(evaluations: Mapping[str, Sequence[EpisodeRecord]], *, title: str, command: str) -> ResultFile:
    """Returns the result of policies' evaluations.

    Args:
        evaluations: label -> records.
        title: one line.
        command: as typed; raises `ConfigurationError` if it contains a local path.

    Raises:
        ConfigurationError: several simulation versions or scene splits are mixed, or settings of one label.
    """
    records = [one for part in evaluations.values() for one in part]
    kinds = sorted({(one.provenance.simulation_version, one.split) for one in records}, key=str)
    if len(kinds) > 1:
        raise ConfigurationError(
            "A result file is of one simulation version and one split of scenes.",
            got="; ".join(f"simulation version {version}, split {split}" for version, split in kinds),
            allowed="episodes of one version and one split",
            hint="a new log, or a result file for each",
        )
    for label, part in evaluations.items():
        for name, values in mixed_settings(part).items():
            raise ConfigurationError(
                f"A result is of one setting, but {LIMITS[name]} are mixed.",
                got=f"{label}: {', '.join(values)}",
                allowed="one value of each setting",
                hint="a log for each, or adamanip report LOG without --pool",
            )
    return make_result(
        [row for label, part in evaluations.items() for row in rows_of_records(part, label)],
        kind="policy",
        title=title,
        command=command,
        seeds=[one.given_seed for one in records],
        scenes=kinds[0][1],
        simulation_version=kinds[0][0],
        version=records[-1].provenance.version,
        versions=joined_versions(one.provenance.versions for one in records),
    )


def write_result(path: Path, result: ResultFile) -> None:
    """Writes a result file; raises `ConfigurationError` if `read_result` would refuse it."""
    content = json.loads(json.dumps(result.to_json()))
    try:
        parse_result(content)
    except ValueError as error:
        raise ConfigurationError(
            "These values make no result file.",
            got=error,
            allowed="labels and a title of one line without |, a command that a shell can read, without backquotes",
            hint="adamanip report LOG --label NAME --title TITLE",
        ) from error
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def read_result(path: Path) -> ResultFile:
    """Reads a result file; raises `DatasetError` if it is invalid."""
    try:
        return parse_result(read(path))
    except (OSError, ValueError) as error:
        raise DatasetError(
            "Not a result file.",
            got=f"{path}: {error}",
            allowed="what `adamanip report --out` or `adamanip benchmark` writes",
            hint="adamanip report LOG --out FILE --command 'lerobot-eval ...', from the episode log",
        ) from error


def read_results(folder: Path) -> dict[str, ResultFile]:
    """Reads all result files of a folder: file name -> result, sorted; raises `DatasetError` if one is invalid."""
    return {path.name: read_result(path) for path in sorted(folder.glob("*.json"))}


def parse_result(content: object) -> ResultFile:
    """Returns the result in decoded JSON; raises ValueError that names the invalid field."""
    result = record(ResultFile)("the result", content)
    commands = [result.command]
    if result.run is not None:
        if EVALUATE not in result.run.steps or len(result.rows) != 1:
            raise ValueError(f"a benchmark's result has one row and a step {EVALUATE}")
        commands += [step.command for step in result.run.steps.values()]
    for command in commands:
        if _PRIVATE_PATH.search(command):
            raise ValueError("command holds a path of one machine")
        shlex.split(command)
    return result
