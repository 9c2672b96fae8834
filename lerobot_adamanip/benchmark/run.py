"""Run a benchmark: execute the missing steps of each cell, in order, until its result is written.

After an interruption, the same call continues with the interrupted step and writes the same results. Collections and
trainings resume; an unfinished evaluation starts again.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from lerobot_adamanip.benchmark.command import Runner, begin_command, end_command
from lerobot_adamanip.benchmark.declaration import Declaration
from lerobot_adamanip.benchmark.episodes import differing_episodes
from lerobot_adamanip.benchmark.folder import BenchmarkFolder
from lerobot_adamanip.benchmark.plan import (
    COLLECT,
    CORRECT,
    EPISODE_LOG,
    MERGE,
    REVISION,
    TRAIN,
    Cell,
    KeyVersions,
    Step,
    evaluation_options,
    named_steps,
    options_key,
    plan,
)
from lerobot_adamanip.contract.versions import mixed_versions
from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled
from lerobot_adamanip.evaluation.provenance import Origin, present_origin
from lerobot_adamanip.evaluation.record import EpisodeRecord, first_episodes, read_log, without_repeats
from lerobot_adamanip.evaluation.results import (
    EVALUATE,
    LOGGED,
    NO_COMMIT,
    CellRun,
    ResultFile,
    ResultRow,
    StepCost,
    StepDone,
    TrainingLog,
    command_options,
    read_result,
    write_result,
)
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, DatasetError

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


_PARAMETERS = re.compile(r"num_learnable_params=(\d+)")
_LOSS = re.compile(r" loss:([-+.\deE]+) ")


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
    result: ResultFile | None = None


@dataclass(frozen=True)
class _RunningStep:
    step: Step
    process: subprocess.Popen[bytes]
    begin: float
    origin: Origin
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
        origin_now: function that returns the origin of a step that begins or ends now: each is a process of its own,
            of the checkout as it is then.
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
    origin_now: Callable[[], Origin] = present_origin
    unavailable: Mapping[str, str] = field(default_factory=dict)
    collect_options: tuple[str, ...] = ()
    jobs: int = 1
    runner: Runner = begin_command
    say: Callable[[str], None] = lambda text: None
    _failed: dict[str, str] = field(default_factory=dict, init=False)
    _running: dict[str, _RunningStep] = field(default_factory=dict, init=False)
    _reopened: set[str] = field(default_factory=set, init=False)

    def state(self, cell: Cell) -> CellState:
        """Returns the progress of a cell; runs nothing."""
        result = read_result(path) if (path := self.folder.result(cell)).exists() else None
        if reason := self.unavailable.get(cell.method):
            return CellState(cell, UNAVAILABLE, reason, result)
        step = self._plan(cell)
        if result is not None:
            mixed = mixed_versions([result.all_versions, self.origin.versions])
            reason = mixed and f"measured with other versions than installed: {mixed}"
            # Reported only: an update of a package changes few numbers, and would repeat days of work.
            return CellState(cell, DONE if result.run and result.run.key == step.key else STALE, reason, result)
        begun = any(self.folder.is_begun(part) for part in step.chain())
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
                for running in self._running.values():
                    end_command(running.process)
                self._running.clear()

    def _advanced(self, waiting: dict[Cell, str], lock: int) -> Iterator[CellState]:
        """Starts all steps that are ready, in the order of cells; yields the cells that are finished."""
        for cell, label in list(waiting.items()):
            try:
                state = self._advanced_cell(cell, label, lock)
            except AdaManipError as error:
                state = CellState(cell, FAILED, str(error))
            if state is not None:
                del waiting[cell]
                yield state

    def _advanced_cell(self, cell: Cell, label: str, lock: int) -> CellState | None:
        """Starts a cell's next step if it is ready; returns the cell's state if it is finished."""
        whole = self._plan(cell)
        while (state := self._ended(cell, whole)) is None and len(self._running) < self.jobs:
            step = self._next_step(whole)
            if step is None or step.key in self._running or self._begun(step, lock, label):
                break
        return state

    def _ended(self, cell: Cell, step: Step) -> CellState | None:
        """Writes the result of a cell whose last step is done, and returns its state; None for any other cell."""
        before = self.state(cell)
        if before.state in (DONE, UNAVAILABLE):
            return before
        for part in step.chain():
            if part.key in self._failed:
                return CellState(cell, FAILED, self._failed[part.key], before.result)
        if self._next_step(step) is not None:
            return None
        try:
            write_result(self.folder.result(cell), self._result(cell, step))
        except StepError as error:  # the log has lost lines since the step was done
            if step.key in self._reopened:
                return CellState(cell, FAILED, str(error), before.result)
            self._reopened.add(step.key)
            self.folder.reopen(step)
            return None
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
        begin, origin = time.perf_counter(), self.origin_now()
        command = self._command(step)
        if not command:
            self._end(step, begin, origin, 0, "")
            return False
        threads, log = 0 if self.jobs == 1 else self._cores_of_a_job, self.folder.log(step)
        process = self.runner(command, folder=self.folder.root, log=log, lock=lock, threads=threads)
        self._running[step.key] = _RunningStep(step, process, begin, origin, command[0], label)
        return True

    def _wait(self) -> None:
        """Waits until a command ends; reports running commands at intervals."""
        due = time.perf_counter() + SIGN_OF_LIFE_SECONDS
        while self._running:
            ended = [(one, status) for one in self._running.values() if (status := one.process.poll()) is not None]
            for running, status in ended:
                del self._running[running.step.key]
                self._end(running.step, running.begin, running.origin, status, running.program)
            if ended:
                return
            if time.perf_counter() >= due:
                due += SIGN_OF_LIFE_SECONDS
                for running in self._running.values():
                    seconds = time.perf_counter() - running.begin
                    line = files.last_line(self.folder.log(running.step))[:_LINE_LENGTH]
                    self.say(f"{running.label}: {WORDS[running.step.kind]} for {seconds:.0f} s: {line}")
            time.sleep(_POLL_SECONDS)

    def _end(self, step: Step, begin: float, origin: Origin, status: int, program: str) -> None:
        try:
            if status:
                log = self.folder.log(step).relative_to(self.folder.root)
                raise StepError(f"{program} ended with status {status}: {log}")
            if step.kind == EVALUATE:
                _require_revision(command_options(shlex.join(step.command)))
                self._records(step)
        except StepError as error:
            self._failed[step.key] = str(error)
            return
        machine = {**self.machine, "cores": self._cores_of_a_job}
        end = self.origin_now()
        is_changed = origin.changed or end.changed or origin.commit != end.commit
        self.folder.finish(step, time.perf_counter() - begin, machine, replace(end, changed=is_changed))
        if not self.folder.is_done(step):
            product = self.folder.product(step).relative_to(self.folder.root)
            self._failed[step.key] = f"{program} has not written what the next steps read: {product}"

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
            if checkpoint := self.folder.resumable(step):
                done, config = checkpoint
                steps = int(command_options(shlex.join(step.command))["--steps"])
                resume = ["lerobot-train", f"--config_path={config}", "--resume=true", f"--steps={steps}"]
                return [] if done >= steps else resume
        # LeRobot rejects a folder without a checkpoint, and a partial episode log would count as complete.
        files.remove_tree(product)
        return whole

    def _records(self, step: Step) -> list[EpisodeRecord]:
        """Returns the episodes of an evaluation; raises `StepError` if they are not the requested ones."""
        options = evaluation_options(shlex.join(step.command))
        count, scenes = int(options["--eval.n_episodes"]), options["--env.split"]
        try:
            records = first_episodes(read_log(self.folder.product(step) / EPISODE_LOG), count)
        except DatasetError as error:
            raise StepError(str(error)) from error
        kinds = {(record.provenance.simulation_version, record.split) for record in records}
        if len(records) != count or kinds != {(self.versions.simulation, scenes)}:
            got = ", ".join(
                f"{split} scenes of simulation version {version}" for version, split in sorted(kinds, key=str)
            )
            raise StepError(
                f"The evaluation {step.key} has the wrong episodes: {len(records)} episodes, {got}; not {count}, "
                f"{scenes} scenes of simulation version {self.versions.simulation}."
            )
        try:
            wrong = differing_episodes(records, options)
        except ConfigurationError as error:
            raise StepError(str(error)) from error
        if wrong:
            raise StepError(f"The evaluation {step.key} has the wrong episodes: {wrong}.")
        return records

    def _origin(self, costs: Mapping[str, StepCost]) -> Origin:
        """Returns the origin of a result: the commit of its evaluation, and whether any step had changes."""
        is_changed = self.origin.changed or any(cost.changed for cost in costs.values())
        commit = costs[EVALUATE].commit or self.origin.commit  # former steps hold none
        return replace(self.origin, commit=None if commit == NO_COMMIT else commit, changed=is_changed)

    def _result(self, cell: Cell, last: Step) -> ResultFile:
        method, records, steps = self.declaration.methods[cell.method], self._records(last), named_steps(last)
        records = without_repeats(records)
        seeds = [record.given_seed for record in records]
        logs = {name: read_training_log(self.folder.log(step)) for name, step in steps.items() if step.kind == TRAIN}
        costs = {name: cost for name, step in steps.items() if (cost := self.folder.cost(step)) is not None}
        commands = {name: shlex.join((*step.command, *step.non_key_options)) for name, step in steps.items()}
        rules = evaluation_options(commands[EVALUATE])["--env.mechanism_rules"]
        return ResultFile(
            **vars(self._origin(costs)),
            kind="expert" if method.expert else "policy",
            title=f"benchmark, scale {self.scale}, training seed {cell.seed}",
            command=commands[EVALUATE],
            simulation_version=self.versions.simulation,
            machine=costs[EVALUATE].machine,
            scenes=records[0].split,
            seeds=(min(seeds), max(seeds)),
            seconds=costs[EVALUATE].seconds,
            rows=(ResultRow.of(method.title, rules, cell.category, cell.objects, records),),
            run=CellRun(
                scale=self.scale,
                method=cell.method,
                package=method.package,
                seed=cell.seed,
                options=options_key(cell, self.declaration, self.scale),
                data_version=self.versions.data,
                steps={name: StepDone(key=step.key, command=commands[name]) for name, step in steps.items()},
                trainings={name: log for name, log in logs.items() if log is not None},
                costs=costs,
            ),
        )


def _require_revision(options: Mapping[str, str]) -> None:
    """Raises `StepError` if the Hub cache's main, whose configuration was read, is not the declared revision."""
    if (revision := options.get(REVISION)) is None:
        return
    from huggingface_hub import constants
    from huggingface_hub.file_download import repo_folder_name

    folder = Path(constants.HF_HUB_CACHE, repo_folder_name(repo_id=options["--policy.path"], repo_type="model"))
    main, declared = (folder / "refs" / name for name in ("main", revision))
    commit = main.read_text().strip() if main.exists() else "no commit"
    if commit not in (revision, declared.read_text().strip() if declared.exists() else revision):
        raise StepError(
            f"The configuration of {options['--policy.path']} is main's, {commit} in the Hub cache, not of {revision}: "
            "download main again, or declare its commit"
        )


def read_training_log(path: Path) -> TrainingLog | None:
    """Returns the training in a log; None if it was interrupted, or if LeRobot has changed the form of its log."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    parameters, losses = _PARAMETERS.findall(text), [float(loss) for loss in _LOSS.findall(text)]
    if len(parameters) != 1 or len(losses) != LOGGED:
        return None
    return TrainingLog(parameters=int(parameters[0]), losses=tuple(losses))
