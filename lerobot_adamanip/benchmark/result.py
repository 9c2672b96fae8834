"""Result file of a cell: metrics and their origin. Times and machines, which differ in every run, are kept apart."""

from __future__ import annotations

import functools
import json
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from lerobot_adamanip.benchmark.cells import Cell
from lerobot_adamanip.benchmark.command_options import evaluation_options, options_of
from lerobot_adamanip.benchmark.declaration import NAME, TITLE
from lerobot_adamanip.benchmark.plan import EVALUATE, FOLDERS, Step
from lerobot_adamanip.benchmark.training_log import TrainingLog
from lerobot_adamanip.contract.versions import joined_versions
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.paired import FAILED, OPENED, WITHIN_TRIES
from lerobot_adamanip.evaluation.provenance import HASH, LINE, MACHINE, VERSION_NUMBER, Origin
from lerobot_adamanip.evaluation.results import check_command
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.files import write_atomically
from lerobot_adamanip.util.json_fields import integer, listing, mapping, number, read, record, text

OBSERVATION_OPTIONS = (
    "--env.num_points", "--env.image_size", "--env.observe_images", "--env.episode_log"
)  # fmt: skip
"""Options of an evaluation's environment that do not change its scenes."""
_STEP_NAME = text(rf"({'|'.join(FOLDERS)})(_\d+)?", "the name of a step")


@dataclass(frozen=True, kw_only=True)
class StepDone:
    """A finished step behind a result: the key of its product, and its command as typed in the benchmark's folder."""

    key: Annotated[str, HASH]
    command: Annotated[str, text(r"[^\r\n`]{1,4000}", "one line without backquotes")]

    @classmethod
    def of(cls, step: Step) -> StepDone:
        """Returns the record of a step."""
        return cls(key=step.key, command=shlex.join((*step.command, *step.non_key_options)))


@dataclass(frozen=True)
class StepCost:
    """Cost of a step, shared by all cells that need it.

    Attributes:
        begun: number of starts; more than one after interruptions.
        seconds: duration of the last run.
        machine: see `machine_class`.
        versions: installed versions at its end; empty in results before simulation version 3.
    """

    begun: Annotated[int, integer(1, 10**6)]
    seconds: Annotated[float, number(0, 10**9)]
    machine: Annotated[Mapping[str, int | bool], MACHINE]
    versions: Annotated[Mapping[str, str], mapping(LINE, LINE, 30)] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class CellResult(Origin):
    """Content of a result file.

    Attributes:
        cell: the measured cell.
        title: name of its method in tables.
        package: distribution that declared the method; empty for the declaration itself.
        scale: name of the scale.
        options: key of the declared options, from `lerobot_adamanip.benchmark.plan.options_key`.
        steps: by name, see `named_steps`; the key of the last one is the cell's key.
        simulation_version, data_version: see `lerobot_adamanip.contract.versions`.
        scene_seeds: first and last seed of the scenes.
        numbers: metrics of the episodes.
        outcomes, failed_tries: of the scenes, see `lerobot_adamanip.evaluation.paired`; empty in results of earlier
            versions.
        trainings: name of step -> log of the training; without those that were interrupted.
        costs: name of step -> cost; differs in every run.
    """

    cell: Annotated[Cell, record(Cell)]
    title: Annotated[str, TITLE]
    package: Annotated[str, text(r"[\w.-]{0,100}", "a distribution's name, or an empty text")]
    scale: Annotated[str, NAME]
    options: Annotated[str, HASH]
    steps: Annotated[Mapping[str, StepDone], mapping(_STEP_NAME, record(StepDone), 100)]
    simulation_version: Annotated[int, VERSION_NUMBER]
    data_version: Annotated[int, VERSION_NUMBER]
    scene_seeds: Annotated[tuple[int, int], listing(integer(0, 2**31), 2, 2)]
    numbers: Annotated[Metrics, Metrics.from_json]
    costs: Annotated[Mapping[str, StepCost], mapping(_STEP_NAME, record(StepCost), 100)]
    trainings: Annotated[Mapping[str, TrainingLog], mapping(_STEP_NAME, record(TrainingLog), 100)] = field(
        default_factory=dict
    )
    outcomes: Annotated[str, text(r"[012]{0,100000}", "a digit 0, 1 or 2 for each scene")] = ""
    failed_tries: Annotated[str, text(r"[0-9]{0,100000}", "a digit for each scene")] = ""
    schema: Annotated[int, integer(1, 1)] = 1

    @property
    def key(self) -> str:
        """Cache key of everything that affects the result."""
        return tuple(self.steps.values())[-1].key

    @functools.cached_property
    def evaluation_options(self) -> Mapping[str, str]:
        """Options of the evaluation, by their names in `lerobot-eval`, read from its command."""
        return evaluation_options(shlex.split(self.steps[EVALUATE].command))

    @property
    def all_versions(self) -> dict[str, str]:
        """Installed versions of all steps, by name; different ones are joined by ``and``."""
        return joined_versions([self.versions, *(cost.versions for cost in self.costs.values())])

    def options_of(self, kind: str) -> Iterator[tuple[str, dict[str, str]]]:
        """Yields name and options of the steps of a kind."""
        for name, step in self.steps.items():
            if name.partition("_")[0] == kind:
                yield name, options_of(shlex.split(step.command))

    @property
    def scenes(self) -> str:
        """Split of the evaluation's scenes."""
        return self.evaluation_options["--env.split"]

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-serialisable dictionary."""
        return {**asdict(self), "numbers": self.numbers.to_json()}


def write_cell(path: Path, result: CellResult) -> None:
    """Writes a result file; its content is validated as `read_cell` does."""
    content = json.loads(json.dumps(result.to_json()))
    parse_cell(content)
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def read_cell(path: Path) -> CellResult:
    """Reads a result file; raises `DatasetError` if it is invalid."""
    try:
        return parse_cell(read(path))
    except (OSError, ValueError) as error:
        raise DatasetError(
            "Not a result of a benchmark.",
            got=f"{path}: {error}",
            allowed="what `adamanip benchmark` writes",
            hint=f"remove {path.name}, and run the benchmark again",
        ) from error


def read_cells(folder: Path) -> list[CellResult]:
    """Reads all result files of a folder, sorted by name; raises `DatasetError` if one is invalid."""
    return [read_cell(path) for path in sorted(folder.glob("*.json"))]


def parse_cell(content: object) -> CellResult:
    """Returns the result in decoded JSON; raises ValueError that names the invalid field."""
    found = record(CellResult)("the result", content)
    if EVALUATE not in found.steps:
        raise ValueError(f"steps lacks {EVALUATE}")
    for step in found.steps.values():
        check_command(step.command)
        shlex.split(step.command)
    _check_outcomes(found)
    return found


def _check_outcomes(found: CellResult) -> None:
    """Raises ValueError if the scenes' outcomes contradict the metrics."""
    numbers, outcomes = found.numbers, found.outcomes
    lengths = {len(each) for each in (outcomes, found.failed_tries) if each}
    if lengths - {numbers.success.episodes}:
        raise ValueError(f"outcomes and failed_tries are not of {numbers.success.episodes} episodes")
    within = numbers.within_best_tries
    if within and (within.episodes != numbers.success.episodes or within.count > numbers.success.count):
        raise ValueError("more episodes, or successes, are within the best strategy's tries than there are")
    opened = len(outcomes) - outcomes.count(FAILED)
    if outcomes and (opened, outcomes.count(WITHIN_TRIES)) != (numbers.success.count, within.count if within else 0):
        raise ValueError("outcomes are not those of the metrics")
    tries = [(outcome, int(count)) for outcome, count in zip(outcomes, found.failed_tries, strict=False)]
    most = max((count for outcome, count in tries if outcome == WITHIN_TRIES), default=0)
    if any(outcome == OPENED and count <= most for outcome, count in tries):
        raise ValueError("outcomes contradict failed_tries")
