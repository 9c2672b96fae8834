"""Folder of a benchmark: products of its steps, a record of each step, and the results.

A step is done once its record says so. The record is written atomically after the command has succeeded.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open

from lerobot_adamanip.benchmark.plan import EPISODE_LOG, FOLDERS, TRAIN, Cell, Step, last_checkpoint
from lerobot_adamanip.evaluation.provenance import Origin
from lerobot_adamanip.evaluation.results import EVALUATE, NO_COMMIT, StepCost
from lerobot_adamanip.util import files, json_fields
from lerobot_adamanip.util.errors import DatasetError

_NOTE = json_fields.either(json_fields.record(StepCost), json_fields.table({"begun": json_fields.integer(1, 10**6)}))
_POLICY_FILES = "*model*", "train_config.json"


@dataclass(frozen=True)
class BenchmarkFolder:
    """Folder of one scale of a benchmark; ``root`` is the working directory of the commands."""

    root: Path

    @property
    def cells(self) -> Path:
        """Returns the folder of the result files."""
        return self.root / "cells"

    def result(self, cell: Cell) -> Path:
        """Returns the result file of a cell, which may not exist yet."""
        return self.cells / f"{cell.name}.json"

    def log(self, step: Step) -> Path:
        """Returns the log file of a step's command."""
        return self._note(step).with_suffix(".log")

    def product(self, step: Step) -> Path:
        """Returns the output folder of a step."""
        return self.root / step.product

    def make(self) -> None:
        """Creates the folders."""
        for name in ("steps", "cells", *FOLDERS.values()):
            (self.root / name).mkdir(parents=True, exist_ok=True)
        for folder in (self.cells, self.root / "steps"):
            files.remove_temporaries(folder)

    def begin(self, step: Step) -> None:
        """Records that a step's command is about to start."""
        self._write(step, {"begun": self._begun(step) + 1})

    def finish(self, step: Step, seconds: float, machine: Mapping[str, int | bool], origin: Origin) -> None:
        """Records that a step's command has succeeded."""
        # A power cut must not take what the record relies on.
        if step.kind == EVALUATE:
            files.sync(self.product(step) / EPISODE_LOG)
        elif step.kind == TRAIN:
            files.sync_tree(self.product(step))
        cost = StepCost(
            max(1, self._begun(step)),
            round(seconds, 1),
            machine,
            origin.versions,
            origin.commit or NO_COMMIT,
            origin.changed,
        )
        self._write(step, asdict(cost))

    def reopen(self, step: Step) -> None:
        """Records that a finished step has to run again."""
        self._write(step, {"begun": max(1, self._begun(step))})

    def cost(self, step: Step) -> StepCost | None:
        """Returns the cost of a step; None if it is not done."""
        note = self._read(step)
        return note if isinstance(note, StepCost) else None

    def is_done(self, step: Step) -> bool:
        """Returns whether a step is done and its product still exists."""
        if self.cost(step) is None:
            return False
        product = self.product(step)
        if step.kind == TRAIN:
            return _are_readable(last_checkpoint(product), *_POLICY_FILES)
        return (product / EPISODE_LOG if step.kind == EVALUATE else product / "meta" / "info.json").exists()

    def is_begun(self, step: Step) -> bool:
        """Returns whether a step was started; it may be done."""
        return self._begun(step) > 0

    def resumable(self, step: Step) -> tuple[int, Path] | None:
        """Returns the newest checkpoint of a training that can be read: its steps and its configuration.

        A checkpoint may be half written until LeRobot links to it. To do so it first removes its link to the one
        before: without a link, the only one may be half written, several are not, and the newest is linked to again.
        """
        last = last_checkpoint(self.product(step)).parent
        folders = sorted(last.parent.glob("[0-9]*"), reverse=True)
        if len(folders) > 1 and not last.is_symlink():
            last.symlink_to(folders[0].name)
        newest = last.resolve().name if last.exists() else ""
        for folder in folders:
            weights, state = folder / "pretrained_model", folder / "training_state"
            is_whole = _are_readable(weights, *_POLICY_FILES) and _are_readable(state, "training_step.json")
            if is_whole and folder.name <= newest:
                steps = json.loads((state / "training_step.json").read_text(encoding="utf-8"))["step"]
                return int(steps), (weights / "train_config.json").relative_to(self.root)
        return None

    def _begun(self, step: Step) -> int:
        note = self._read(step)
        return note.begun if isinstance(note, StepCost) else note.get("begun", 0)

    def _note(self, step: Step) -> Path:
        return self.root / "steps" / f"{step.kind}-{step.key}.json"

    def _write(self, step: Step, note: Mapping[str, object]) -> None:
        files.write_atomically(self._note(step), (json.dumps(note) + "\n").encode())

    def _read(self, step: Step) -> StepCost | dict[str, int]:
        """Returns the cost of a finished step, the number of starts of an unfinished one, or an empty dictionary."""
        path = self._note(step)
        if not path.exists():
            return {}
        try:
            note: StepCost | dict[str, int] = _NOTE("the note", json_fields.read(path))
        except ValueError as error:
            raise DatasetError(
                "A step record is damaged.",
                got=f"{path}: {error}",
                allowed="what was written",
                hint=f"rm {shlex.quote(str(path))}",
            ) from error
        return note


def _are_readable(folder: Path, *needed: str) -> bool:
    """Returns whether a folder has a file of each pattern, and none that a power cut has emptied or cut."""
    try:
        for path in folder.rglob("*"):
            if path.suffix == ".json":
                json.loads(path.read_text(encoding="utf-8"))
            elif path.suffix == ".safetensors":
                with safe_open(path, "numpy"):
                    pass
    except (OSError, ValueError, SafetensorError):
        return False
    return all(any(path.stat().st_size for path in folder.glob(pattern)) for pattern in needed)
