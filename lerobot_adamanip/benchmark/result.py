"""Result file of a cell: its metrics with what made them; times and machines apart, because they differ every time."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from lerobot_adamanip.benchmark.cells import Cell
from lerobot_adamanip.benchmark.declaration import NAME, TITLE
from lerobot_adamanip.benchmark.plan import EVALUATE, FOLDERS, Step, option
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.provenance import HASH, MACHINE, Origin
from lerobot_adamanip.evaluation.results import check_command
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.files import write_atomically
from lerobot_adamanip.util.json_fields import integer, listing, mapping, number, read, record, text

_STEP_NAME = text(rf"({'|'.join(FOLDERS)})(_\d+)?", "the name of a step")


@dataclass(frozen=True, kw_only=True)
class StepDone:
    """A step behind a result: the key of its product, and the command as typed in the benchmark's folder."""

    key: Annotated[str, HASH]
    command: Annotated[str, text(r"[^\r\n`]{1,4000}", "one line without backquotes")]

    @classmethod
    def of(cls, step: Step) -> StepDone:
        """Returns the note of a step."""
        return cls(key=step.key, command=shlex.join((*step.command, *step.non_key_options)))


@dataclass(frozen=True)
class StepCost:
    """What a step took; shared by all cells that need it.

    Attributes:
        begun: how often it was begun; more than once after interruptions.
        seconds: of the last time.
        machine: see `machine_class`.
    """

    begun: Annotated[int, integer(1, 10**6)]
    seconds: Annotated[float, number(0, 10**9)]
    machine: Annotated[Mapping[str, int | bool], MACHINE]


@dataclass(frozen=True, kw_only=True)
class CellResult(Origin):
    """Content of a result file.

    Attributes:
        cell: which one.
        title: of its method, in tables.
        package: distribution that declared the method; empty for the declaration itself.
        scale: name.
        options: `lerobot_adamanip.benchmark.plan.options_key` of what was declared.
        steps: by name, see `named_steps`; the last one's key is the cell's.
        fingerprint: of the code that decided the episodes.
        scene_seeds: the first scene's and the last one's.
        numbers: of its episodes.
        costs: by name of step; all that is not the same every time.
    """

    cell: Annotated[Cell, record(Cell)]
    title: Annotated[str, TITLE]
    package: Annotated[str, text(r"[\w.-]{0,100}", "a distribution's name, or nothing")]
    scale: Annotated[str, NAME]
    options: Annotated[str, HASH]
    steps: Annotated[Mapping[str, StepDone], mapping(_STEP_NAME, record(StepDone), 100)]
    fingerprint: Annotated[str, HASH]
    scene_seeds: Annotated[tuple[int, int], listing(integer(0, 2**31), 2, 2)]
    numbers: Annotated[Metrics, Metrics.from_json]
    costs: Annotated[Mapping[str, StepCost], mapping(_STEP_NAME, record(StepCost), 100)]
    schema: Annotated[int, integer(1, 1)] = 1

    @property
    def key(self) -> str:
        """Of everything that decided it."""
        return tuple(self.steps.values())[-1].key

    @property
    def scenes(self) -> str:
        """Split of the scenes that its evaluation ran on, by its command."""
        return option(shlex.split(self.steps[EVALUATE].command), "--env.split")

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        return {**asdict(self), "numbers": self.numbers.to_json()}


def write_cell(path: Path, result: CellResult) -> None:
    """Writes a result file; its content is checked as that of a stranger's file is."""
    content = json.loads(json.dumps(result.to_json()))
    parse_cell(content)
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def read_cell(path: Path) -> CellResult:
    """Reads a result file; raises `DatasetError` if it is none."""
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
    """Reads all result files of a folder, in order of their names; raises `DatasetError` for one that is none."""
    return [read_cell(path) for path in sorted(folder.glob("*.json"))]


def parse_cell(content: object) -> CellResult:
    """Returns the result in decoded JSON; raises ValueError that names what is wrong with it."""
    found = record(CellResult)("the result", content)
    if not found.steps:
        raise ValueError("steps is empty")
    for step in found.steps.values():
        check_command(step.command)
    return found
