"""Result file of a cell: its metrics with what made them; times and machines apart, because they differ every time."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.benchmark.cells import Cell
from lerobot_adamanip.benchmark.declaration_fields import NAME, OBJECT_SPLITS, TITLE
from lerobot_adamanip.benchmark.plan import EVALUATE, FOLDERS, Step, option
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.provenance import HASH, MACHINE, ORIGIN, Origin
from lerobot_adamanip.evaluation.results import check_command
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.files import write_atomically

SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class StepDone:
    """A step behind a result.

    Attributes:
        key: of what it made.
        command: as typed in the benchmark's folder.
    """

    key: str
    command: str

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

    begun: int
    seconds: float
    machine: Mapping[str, int | bool]


@dataclass(frozen=True, kw_only=True)
class CellResult:
    """Content of a result file.

    Attributes:
        cell: which one.
        title: of its method, in tables.
        package: distribution that declared the method; empty for the declaration itself.
        scale: name.
        options: `lerobot_adamanip.benchmark.plan.options_key` of what was declared.
        steps: by name, see `named_steps`; the last one's key is the cell's.
        fingerprint: of the code that decided the episodes.
        origin: commit and versions.
        scene_seeds: the first scene's and the last one's.
        numbers: of its episodes.
        costs: by name of step; all that is not the same every time.
    """

    cell: Cell
    title: str
    package: str
    scale: str
    options: str
    steps: Mapping[str, StepDone]
    fingerprint: str
    origin: Origin
    scene_seeds: tuple[int, int]
    numbers: Metrics
    costs: Mapping[str, StepCost]

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
        return {
            "schema": SCHEMA,
            "cell": asdict(self.cell),
            "title": self.title,
            "package": self.package,
            "scale": self.scale,
            "options": self.options,
            "steps": {kind: asdict(step) for kind, step in self.steps.items()},
            "fingerprint": self.fingerprint,
            **asdict(self.origin),
            "scene_seeds": list(self.scene_seeds),
            "numbers": self.numbers.to_json(),
            "costs": {kind: asdict(cost) for kind, cost in self.costs.items()},
        }


def write_cell(path: Path, result: CellResult) -> None:
    """Writes a result file; its content is checked as that of a stranger's file is."""
    content = result.to_json()
    parse_cell(json.loads(json.dumps(content)))
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def read_cell(path: Path) -> CellResult:
    """Reads a result file; raises `DatasetError` if it is none."""
    try:
        return parse_cell(json_fields.read(path))
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
    found = _CELL_RESULT("the result", content)
    del found["schema"]
    origin = Origin(**{name: found.pop(name) for name in ORIGIN})
    cell, scene_seeds = Cell(**found.pop("cell")), found.pop("scene_seeds")
    steps = {kind: StepDone(**step) for kind, step in found.pop("steps").items()}
    costs = {kind: StepCost(**cost) for kind, cost in found.pop("costs").items()}
    if not steps:
        raise ValueError("steps is empty")
    for step in steps.values():
        check_command(step.command)
    return CellResult(
        cell=cell, origin=origin, steps=steps, costs=costs, scene_seeds=(scene_seeds[0], scene_seeds[1]), **found
    )


_LINE = json_fields.text(r"[^\r\n`]{1,4000}", "one line without backquotes")
_NAME = json_fields.text(rf"({'|'.join(FOLDERS)})(_\d+)?", "the name of a step")
STEP_COST = json_fields.table(
    {"begun": json_fields.integer(1, 10**6), "seconds": json_fields.number(0, 10**9), "machine": MACHINE}
)
"""Check of a `StepCost`."""
_CELL_RESULT = json_fields.table(
    {
        "schema": json_fields.integer(SCHEMA, SCHEMA),
        "cell": json_fields.table(
            {
                "method": NAME,
                "category": json_fields.choice(tuple(CATEGORIES)),
                "objects": json_fields.choice(OBJECT_SPLITS),
                "seed": json_fields.integer(0, 2**31),
                "trials": json_fields.optional(json_fields.integer(0, 1000)),
            }
        ),
        "title": TITLE,
        "package": json_fields.text(r"[\w.-]{0,100}", "a distribution's name, or nothing"),
        "scale": NAME,
        "options": HASH,
        "steps": json_fields.mapping(_NAME, json_fields.table({"key": HASH, "command": _LINE}), 100),
        **ORIGIN,
        "fingerprint": HASH,
        "scene_seeds": json_fields.listing(json_fields.integer(0, 2**31), 2, 2),
        "numbers": Metrics.from_json,
        "costs": json_fields.mapping(_NAME, STEP_COST, 100),
    }
)
