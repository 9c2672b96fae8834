"""Run a benchmark: execute the missing steps of each cell, in order, until its result is written.

After an interruption, the same call continues with the interrupted step and writes the same results. Collections and
trainings resume; an unfinished evaluation starts again.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from lerobot_adamanip.benchmark.cells import Cell
from lerobot_adamanip.benchmark.command import Runner, begin_command, end_command
from lerobot_adamanip.benchmark.command_options import evaluation_options, option
from lerobot_adamanip.benchmark.declaration import Declaration
from lerobot_adamanip.benchmark.folder import BenchmarkFolder
from lerobot_adamanip.benchmark.plan import (
    COLLECT,
    CORRECT,
    EPISODE_LOG,
    EVALUATE,
    MERGE,
    TRAIN,
    KeyVersions,
    Step,
    last_checkpoint,
    named_steps,
    options_key,
    plan,
)
from lerobot_adamanip.benchmark.result import CellResult, StepDone, read_cell, write_cell
from lerobot_adamanip.benchmark.training_log import TrainingLog, read_training_log
from lerobot_adamanip.contract.versions import mixed_versions
from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled
from lerobot_adamanip.evaluation.groups import first_episodes, without_repeats
from lerobot_adamanip.evaluation.log import read_log
from lerobot_adamanip.evaluation.metrics import measure
from lerobot_adamanip.evaluation.paired import failed_tries, outcomes
from lerobot_adamanip.evaluation.provenance import Origin
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import AdaManipError, DatasetError

DONE, STALE, BEGUN, MISSING, UNAVAILABLE, FAILED = "done", "stale", "begun", "missing", "unavailable", "failed"
"""States of a cell. Stale: result of other versions or other options. Begun: at least one step was started."""
_POLL_SECONDS = 0.02
SIGN_OF_LIFE_SECONDS = 30.0
"""Interval at which a running step is reported with the last line of its log."""
_LINE_LENGTH = 120
WORDS = {
    COLLECT: "collecting",
    CORRECT: "correcting",
    MERGE: "merging",
    TRAIN: "training",
    EVALUATE: "evaluating",
}


class StepError(AdaManipError, RuntimeError):
    """A command of a benchmark has failed."""


@dataclass(frozen=True)
class CellState:
    """Progress of a cell.

    Attributes:
        cell: the cell.
        state: see `DONE` and the others.
        reason: why it is unavailable or has failed, or which installed versions its result differs in; may be empty.
        result: content of its result file, if it exists.
    """

    cell: Cell
    state: str
    reason: str = ""
    result: CellResult | None = None


@dataclass(frozen=True)
class _RunningStep:
    step: Step
    process: subprocess.Popen[bytes]
    begin: float
    program: str
    label: str


@dataclass
class BenchmarkRun:
    """Run of one scale of a benchmark in a folder.

    Attributes:
        declaration, scale: the benchmark.
        folder: its folder.
        versions: versions in the cache keys.
        origin: origin of the results.
        machine: class of this machine, see `machine_class`.
        unavailable: method -> why it cannot run here.
        collect_options: options of ``adamanip collect`` that change no result: workers, cluster.
        jobs: number of parallel commands; they share the cores equally.
        runner: function that starts commands.
        say: callback for progress messages.
    """

    declaration: Declaration
    scale: str
    folder: BenchmarkFolder
    versions: KeyVersions
    origin: Origin
    machine: Mapping[str, int | bool]
    unavailable: Mapping[str, str] = field(default_factory=dict)
    collect_options: tuple[str, ...] = ()
    jobs: int = 1
    runner: Runner = begin_command
    say: Callable[[str], None] = lambda text: None
    _failed: dict[str, str] = field(default_factory=dict, init=False)
    _running: dict[str, _RunningStep] = field(default_factory=dict, init=False)

    def state(self, cell: Cell) -> CellState:
        """Returns the progress of a cell; runs nothing."""
        result = read_cell(path) if (path := self.folder.result(cell)).exists() else None
        if reason := self.unavailable.get(cell.method):
            return CellState(cell, UNAVAILABLE, reason, result)
        step = self._plan(cell)
        if result is not None:
            mixed = mixed_versions([result.all_versions, self.origin.versions])
            reason = mixed and f"measured with other versions than installed: {mixed}"
            # Told only: an update of a package changes few numbers, and would repeat days of work.
            return CellState(cell, DONE if result.key == step.key else STALE, reason, result)
        begun = any(self.folder.is_begun(each) for each in step.chain())
        return CellState(cell, BEGUN if begun else MISSING)

    def run(self, cells: Sequence[Cell]) -> Iterator[CellState]:
        """Runs the missing steps of each cell and yields its final state; a failed cell does not stop the others.

        Raises:
            DatasetError: another benchmark is running in the folder.
        """
        self.folder.make()
        busy = "A benchmark, or a command that it has left behind, is running in this folder."
        with files.locked(self.folder.root, busy, "wait for its end, or use another --out") as lock:
            waiting = {cell: f"[{number}/{len(cells)}] {cell.name}" for number, cell in enumerate(cells, start=1)}
            try:
                while waiting:
                    yield from self._advanced(waiting, lock)
                    self._wait()
            finally:
                for each in self._running.values():
                    end_command(each.process)
                self._running.clear()

    def _advanced(self, waiting: dict[Cell, str], lock: int) -> Iterator[CellState]:
        """Starts all steps that are ready, in the order of cells; yields the cells that are finished."""
        for cell, label in list(waiting.items()):
            whole = self._plan(cell)
            state = self._ended(cell, whole)
            while state is None and len(self._running) < self.jobs:
                step = self._next_step(whole)
                if step is None or step.key in self._running or self._begun(step, lock, label):
                    break
                state = self._ended(cell, whole)  # there was nothing left to run
            if state is not None:
                del waiting[cell]
                yield state

    def _ended(self, cell: Cell, step: Step) -> CellState | None:
        """Writes the result of a cell whose last step is done, and returns its state; None for any other cell."""
        before = self.state(cell)
        if before.state in (DONE, UNAVAILABLE):
            return before
        for each in step.chain():
            if each.key in self._failed:
                return CellState(cell, FAILED, self._failed[each.key], before.result)
        if self._next_step(step) is not None:
            return None
        try:
            write_cell(self.folder.result(cell), self._result(cell, step))
        except StepError as error:
            return CellState(cell, FAILED, str(error), before.result)
        return self.state(cell)

    def _next_step(self, whole: Step) -> Step | None:
        """Returns the first step to run; inputs of finished steps are not needed any more."""
        if self.folder.is_done(whole):
            return None
        return next((missing for need in whole.needs if (missing := self._next_step(need))), whole)

    def _begun(self, step: Step, lock: int, label: str) -> bool:
        """Starts a step; False if it finished at once because its command had nothing left to do."""
        self.say(f"{label}: {WORDS[step.kind]}, log: {self.folder.log(step)}")
        self.folder.begin(step)
        begin = time.perf_counter()
        command = self._command(step)
        if not command:
            self._end(step, begin, 0, "")
            return False
        threads, log = 0 if self.jobs == 1 else self._cores_of_a_job, self.folder.log(step)
        process = self.runner(command, folder=self.folder.root, log=log, lock=lock, threads=threads)
        self._running[step.key] = _RunningStep(step, process, begin, command[0], label)
        return True

    def _wait(self) -> None:
        """Waits until a command ends; reports running commands at intervals."""
        due = time.perf_counter() + SIGN_OF_LIFE_SECONDS
        while self._running:
            ended = [(each, status) for each in self._running.values() if (status := each.process.poll()) is not None]
            for each, status in ended:
                del self._running[each.step.key]
                self._end(each.step, each.begin, status, each.program)
            if ended:
                return
            if time.perf_counter() >= due:
                due += SIGN_OF_LIFE_SECONDS
                for each in self._running.values():
                    seconds = time.perf_counter() - each.begin
                    line = files.last_line(self.folder.log(each.step))[:_LINE_LENGTH]
                    self.say(f"{each.label}: {WORDS[each.step.kind]} for {seconds:.0f} s: {line}")
            time.sleep(_POLL_SECONDS)

    def _end(self, step: Step, begin: float, status: int, program: str) -> None:
        try:
            if status:
                log = self.folder.log(step).relative_to(self.folder.root)
                raise StepError(f"{program} ended with status {status}: {log}")
            if step.kind == EVALUATE:
                self._records(step)
        except StepError as error:
            self._failed[step.key] = str(error)
            return
        machine = {**self.machine, "cores": self._cores_of_a_job}
        self.folder.finish(step, time.perf_counter() - begin, machine, self.origin.versions)

    @property
    def _cores_of_a_job(self) -> int:
        return max(1, self.machine["cores"] // self.jobs)

    def _plan(self, cell: Cell) -> Step:
        return plan(cell, self.declaration, self.scale, self.versions)

    def _command(self, step: Step) -> list[str]:
        """Returns the command that continues a step; empty if the step has nothing left to do."""
        product, whole = self.folder.product(step), [*step.command, *step.non_key_options]
        if step.kind in (COLLECT, CORRECT):
            return [*whole, *self.collect_options]
        if step.kind == TRAIN:
            leave_poses_unscaled(self.folder.product(step.needs[0]))  # for all methods, including LeRobot's own
            if behind := self.folder.trained_steps(step):
                wanted = int(option(step.command, "--steps"))
                config = last_checkpoint(step.product) / "train_config.json"
                resumed = ["lerobot-train", f"--config_path={config}", "--resume=true", f"--steps={wanted}"]
                return [] if behind >= wanted else resumed
        # LeRobot rejects a folder without a checkpoint, and a partial episode log would count as complete.
        files.remove_tree(product)
        return whole

    def _records(self, step: Step) -> list[EpisodeRecord]:
        """Returns the episodes of an evaluation; raises `StepError` if they are not the requested ones."""
        options = evaluation_options(step.command)
        wanted, scenes = int(options["--eval.n_episodes"]), options["--env.split"]
        try:
            records = first_episodes(read_log(self.folder.product(step) / EPISODE_LOG), wanted)
        except DatasetError as error:
            raise StepError(str(error)) from error
        made = {(record.provenance.simulation_version, record.split) for record in records}
        if len(records) != wanted or made != {(self.versions.simulation, scenes)}:
            got = ", ".join(f"{split} scenes of simulation version {each}" for each, split in sorted(made, key=str))
            raise StepError(
                f"The evaluation {step.key} has the wrong episodes: {len(records)} episodes, {got}; not {wanted}, "
                f"{scenes} scenes of simulation version {self.versions.simulation}."
            )
        return records

    def _training_log(self, step: Step) -> TrainingLog | None:
        return read_training_log(self.folder.log(step)) if step.kind == TRAIN else None

    def _result(self, cell: Cell, step: Step) -> CellResult:
        method, records, steps = self.declaration.methods[cell.method], self._records(step), named_steps(step)
        records = without_repeats(records)
        seeds = [record.given_seed for record in records]
        return CellResult(
            cell=cell,
            title=method.title,
            package=method.package,
            scale=self.scale,
            options=options_key(cell, self.declaration, self.scale),
            steps={name: StepDone.of(each) for name, each in steps.items()},
            simulation_version=self.versions.simulation,
            data_version=self.versions.data,
            **vars(self.origin),
            scene_seeds=(min(seeds), max(seeds)),
            numbers=measure(records),
            outcomes=outcomes(records),
            failed_tries=failed_tries(records),
            trainings={name: log for name, each in steps.items() if (log := self._training_log(each)) is not None},
            costs={name: cost for name, each in steps.items() if (cost := self.folder.cost(each)) is not None},
        )
