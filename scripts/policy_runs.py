"""Trains and evaluates `dp3_adaptive`, category by category: collect, lerobot-train, lerobot-eval, report.

Each step is left out where its result is there already, so an interrupted run goes on, with the command it was begun
with. One thing at a time: two cores are no more. For example, the default on validation scenes:

    python scripts/policy_runs.py --category door,lamp --name default --episodes 100
    python scripts/policy_runs.py --category door --name wide --train=--policy.trunk_dim=512
    python scripts/policy_runs.py --category door --name corrected --corrections 5
    python scripts/policy_runs.py --category door --name again --after corrected --corrections 5
    python scripts/policy_runs.py --category suite --name one --steps 20000 --train=--policy.num_anchors=96

``suite`` is one policy of all categories: their demonstrations merged, told what to do, each category counting alike.
Models are chosen on ``--split validation``; ``test`` is for numbers that are reported. A table of all runs in ``--out``
follows from their logs: ``python scripts/policy_runs.py --table``. ``--result FILE`` writes the runs of ``--name`` for
docs/results.md; several settings (``--name default,wide``) stand side by side, and with ``--spread``, of settings that
differ in their ``--seed`` alone, mean and spread.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from check_common import ROOT, count, list_of

from lerobot_adamanip.benchmark.command import environment
from lerobot_adamanip.benchmark.training import last_checkpoint, resuming, trained_steps
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.log import read_log
from lerobot_adamanip.evaluation.metrics import first_episodes, summarise
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.result_rows import rows_of_records
from lerobot_adamanip.evaluation.results import policy_result, write_result
from lerobot_adamanip.experts import EXPERT_STRATEGIES
from lerobot_adamanip.util.files import write_atomically

BIN = Path(sys.executable).parent
SUITE = "suite"
SAVE_EVERY = 4000
"""Steps that an interrupted training loses at most."""
SEVERAL_TASKS = ("--policy.use_instruction=true", "--policy.balance_tasks=true")
OBJECTS = ("seen", "unseen", "novel")


@dataclass(frozen=True)
class Run:
    """One training of one category, and where it lies.

    Attributes:
        folder: of checkpoints, logs and what was done.
        category: of its objects.
        options: of the command line.
    """

    folder: Path
    category: str
    options: argparse.Namespace

    @property
    def before(self) -> Path | None:
        """Folder of the run whose corrected policy is corrected again here, and which learned from ``both`` there.

        A run with a training of its own follows none: settings of both kinds may stand in one result.
        """
        after = self.options.after
        begun_here = (self.folder / "train").exists()
        return self.folder.parent / f"{after}-{self.category}" if after and not begun_here else None

    def collect(self) -> None:
        """Records the demonstrations, of all categories for the suite."""
        if self.before is not None or _recorded(self.data):
            return
        if self.category == SUITE:
            parts = [Run(self.folder.parent / category, category, self.options) for category in CATEGORIES]
            for part in parts:
                part.collect()
            self._merge("merge", [part.data for part in parts], self.data)
            return
        given = self.options
        of = ("--objects", given.train_objects, "--expert", given.expert, "--expert-strategy", given.expert_preset)
        self._run("collect", *self._recording(self.data, given.episodes_per_object), *of)

    def train(self) -> None:
        """Trains, on from the last checkpoint if there is one."""
        if self.before is None:
            self._train("train", self.data, self.options.steps, self._begin())

    def _begin(self, policy: str = "--policy.type=dp3_adaptive") -> list[str]:
        begin = [policy, "--policy.device=cpu", "--policy.push_to_hub=false"]
        return [*begin, *(SEVERAL_TASKS if self.category == SUITE else ()), *self.options.train]

    def correct(self) -> None:
        """Lets the policy drive and the expert correct it; trains on both, anew or on from where it was (DAgger)."""
        given, corrections, both = self.options, self.folder / "corrections", self.folder / "both"
        if not self.corrected:
            return
        if not _recorded(corrections):
            policy = ("--policy", str(self.checkpoint("train")), "--objects", given.train_objects)
            expert = ("--expert-strategy", given.expert_preset)
            self._run("correct", *self._recording(corrections, given.corrections), *policy, *expert)
        if not _recorded(both):
            self._merge("merge", [self.data, corrections], both)
        going_on = given.correction_start == "trained"
        begin = self._begin(f"--policy.path={self.checkpoint('train')}") if going_on else self._begin()
        self._train("retrain", both, given.correction_steps, begin)

    @property
    def corrected(self) -> bool:
        """Whether this category's policy is corrected."""
        given = self.options
        return bool(given.corrections) and (not given.corrected or self.category in given.corrected)

    def _merge(self, step: str, parts: list[Path], whole: Path) -> None:
        self._run(step, "adamanip", "merge", *map(str, parts), "--out", str(whole))

    def evaluate(self, objects: str) -> None:
        """Evaluates on objects of a split; a log that was not finished is begun anew."""
        given, log = self.options, self.log(objects)
        finished = log.with_suffix(".done")
        if finished.exists():
            return
        log.unlink(missing_ok=True)
        self._run(
            "evaluate",
            "lerobot-eval",
            f"--policy.path={self.checkpoint('retrain' if self.corrected else 'train')}",
            "--policy.device=cpu",
            f"--env.type=adamanip{'' if self.category == SUITE else f'_{self.category}'}",
            f"--env.objects={objects}",
            f"--env.split={given.split}",
            "--env.observe_images=false",
            f"--env.episode_log={log}",
            f"--eval.n_episodes={given.episodes}",
            "--eval.batch_size=2",
            f"--output_dir={self.folder / 'eval'}",
        )
        finished.touch()

    def checkpoint(self, training: str) -> Path:
        """Folder of the last weights of a training."""
        if training == "train" and self.before is not None:
            return last_checkpoint(self.before / "retrain")
        return last_checkpoint(self.folder / training)

    def _recording(self, root: Path, episodes: int) -> list[str]:
        count = ("--episodes-per-object", str(episodes), "--workers", "2")
        return ["adamanip", "collect", str(root), "--category", self.category, "--no-images", *count]

    def _train(self, name: str, data: Path, wanted: int, begin: list[str]) -> None:
        given, folder = self.options, self.folder / name
        done = trained_steps(folder)
        if done >= wanted:
            return
        if done:
            self._run(name, *resuming(folder, wanted))
            return
        self._run(
            name,
            "lerobot-train",
            *begin,
            f"--dataset.repo_id=local/{data.name}",
            f"--dataset.root={data}",
            f"--batch_size={given.batch_size}",
            f"--steps={wanted}",
            f"--save_freq={min(wanted, SAVE_EVERY)}",
            "--log_freq=200",
            "--num_workers=0",
            f"--seed={given.seed}",
            f"--output_dir={folder}",
        )

    @property
    def data(self) -> Path:
        """Folder of the demonstrations, and of earlier corrections."""
        if self.before is not None:
            return self.before / "both"
        return Path(self.options.data.format(category=self.category)).absolute()

    def log(self, objects: str) -> Path:
        """Episode log of an evaluation."""
        return self.folder / f"{self.options.split}-{objects}.jsonl"

    def _run(self, step: str, command: str, *arguments: str) -> None:
        """Runs a command of the project's; keeps what it says, how long it took, and what it was."""
        self.folder.mkdir(parents=True, exist_ok=True)
        say(f"{self.folder.name}: {step}")
        begin = time.perf_counter()
        with (self.folder / f"{step}.log").open("ab") as told:
            done = subprocess.run(
                [str(BIN / command), *arguments], cwd=ROOT, env=environment(), stdout=told, stderr=told, check=False
            )
        if done.returncode:
            raise SystemExit(f"{command} failed with {done.returncode}: {self.folder / f'{step}.log'}")
        entry = {"step": step, "command": [command, *arguments], "seconds": round(time.perf_counter() - begin, 1)}
        write_atomically(self.folder / "steps.json", json.dumps([*steps(self.folder), entry], indent=1).encode())


def _recorded(root: Path) -> bool:
    return (root / "meta" / "info.json").exists()


def steps(folder: Path) -> list[dict[str, Any]]:
    """Returns what was done in a run's folder."""
    path = folder / "steps.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else []


def summary(folder: Path, episodes: int) -> Iterator[dict[str, Any]]:
    """Yields a row of numbers for each finished evaluation of a run, and each category in it."""
    minutes = train_minutes(folder)
    for log in sorted(folder.glob("*-*.jsonl")):
        if not log.with_suffix(".done").exists():
            continue
        records = first_episodes(read_log(log), episodes)
        for category in sorted({record.category for record in records}):
            found = numbers([record for record in records if record.category == category])
            where = {"run": folder.name, "category": category, "scenes": log.stem}
            yield {**where, **found, "train_minutes": round(minutes, 1)}


def train_minutes(folder: Path) -> float:
    """Returns how long a run trained, in all."""
    return float(sum(entry["seconds"] for entry in steps(folder) if entry["step"] in ("train", "retrain")) / 60)


def write_results(options: argparse.Namespace) -> None:
    """Writes a result file of the runs, settings and categories, that the command line names."""
    rows, records = [], []
    for name, category in itertools.product(options.name, options.category):
        run = Run(options.out / f"{name}-{category}", category, options)
        logs = [run.log(objects) for objects in options.objects if run.log(objects).with_suffix(".done").exists()]
        found = [record for log in logs for record in first_episodes(read_log(log), options.episodes)]
        minutes = sum(train_minutes(folder) for folder in (run.before, run.folder) if folder is not None)
        rows += rows_of_records(found, name, round(minutes, 1))
        records += found
    if not records:
        raise SystemExit(f"nothing to write into {options.result}: no evaluation is finished")
    command = shlex.join(["python", "scripts/policy_runs.py", *sys.argv[1:]])
    kind = "seeds" if options.spread else "policy"
    result = policy_result(rows, records, title=options.title, command=command, kind=kind)
    write_result(options.result, result)
    say(f"written: {options.result}")


def numbers(records: list[EpisodeRecord]) -> dict[str, Any]:
    """Returns successes, their interval, and what tries came to: wasted is beyond the best possible, per success."""
    found = summarise(records)
    all_of_it, after = found.overall, found.recovery
    return {
        "episodes": all_of_it.success.episodes,
        "successes": all_of_it.success.count,
        "interval": [round(all_of_it.success.low, 3), round(all_of_it.success.high, 3)],
        "failed_tries": round(sum(record.failed_tries for record in records) / max(1, len(records)), 2),
        "wasted_tries": _rounded(all_of_it.tries and all_of_it.tries.wasted, 2),
        "repeated": f"{after.repeated.count}/{after.repeated.episodes}",
        "something_new": {count: f"{rate.count}/{rate.episodes}" for count, rate in after.untried.items()},
        "key_frames_of_successes": _rounded(all_of_it.key_frames_of_successes, 1),
    }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def say(text: str) -> None:
    """Progress."""
    sys.stderr.write(f"{time.strftime('%H:%M:%S')} {text}\n")
    sys.stderr.flush()


def arguments() -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", type=list_of((*CATEGORIES, SUITE)), default=tuple(CATEGORIES))
    parser.add_argument(
        "--name", type=list_of(None), default=("default",), help="of the setting; a run is NAME-CATEGORY (default)"
    )
    parser.add_argument("--data", default="outputs/suite/{category}", help="of the demonstrations (%(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "outputs" / "runs", help="folder of the runs (%(default)s)")
    parser.add_argument("--train-objects", default="seen")
    parser.add_argument("--episodes-per-object", type=count, default=20)
    parser.add_argument(
        "--expert", default="adaptive", help="of the demonstrations: adaptive, or static, which sees all"
    )
    parser.add_argument(
        "--expert-preset", choices=EXPERT_STRATEGIES, default="paper", help="of the adaptive expert (%(default)s)"
    )
    parser.add_argument("--steps", type=count, default=4000)
    parser.add_argument("--batch-size", type=count, default=64)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument(
        "--train", action="append", default=[], help="one more option of lerobot-train, may be repeated"
    )
    parser.add_argument("--corrections", type=int, default=0, help="corrected episodes per object (%(default)s)")
    parser.add_argument("--after", help="setting whose corrected policies are corrected again, one more round")
    parser.add_argument(
        "--corrected", type=list_of((*CATEGORIES, SUITE)), default=(), help="categories; all if left out"
    )
    parser.add_argument("--correction-steps", type=count, default=6000, help="of the training with them (%(default)s)")
    parser.add_argument(
        "--correction-start", choices=("new", "trained"), default="new", help="begin with new weights (%(default)s)"
    )
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--objects", type=list_of(OBJECTS), default=("seen",), help="evaluated on: seen, unseen, novel")
    parser.add_argument("--episodes", type=count, default=100, help="of an evaluation (%(default)s)")
    parser.add_argument("--collect-only", action="store_true")
    parser.add_argument("--table", action="store_true", help="only print what is there")
    parser.add_argument("--result", type=Path, help="write a result file, for docs/results.md, of these runs")
    parser.add_argument("--spread", action="store_true", help="the settings differ in --seed alone: mean and spread")
    parser.add_argument("--title", default="policies", help="of the result file, one line (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print the table as JSON")
    options = parser.parse_args()
    if options.after and not options.corrections:
        parser.error("--after corrects a policy again: how often per object? (--corrections)")
    return options


def main() -> int:
    """Runs what is missing, and prints a table."""
    options = arguments()
    options.out = options.out.absolute()
    for name, category in () if options.table else itertools.product(options.name, options.category):
        run = Run(options.out / f"{name}-{category}", category, options)
        run.collect()
        if options.collect_only:
            continue
        run.train()
        run.correct()
        for objects in options.objects:
            run.evaluate(objects)
    if options.result is not None:
        write_results(options)
    rows = [row for folder in sorted(options.out.glob("*-*")) for row in summary(folder, options.episodes)]
    if options.json:
        sys.stdout.write(json.dumps(rows) + "\n")
        return 0
    for row in rows:
        sys.stdout.write("  ".join(f"{name} {value}" for name, value in row.items()) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
