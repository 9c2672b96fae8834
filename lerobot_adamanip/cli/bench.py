"""`adamanip bench`: measure collection, simulation, training and action, beside a peer or an older revision."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.cli.arguments import Category
from lerobot_adamanip.evaluation.provenance import machine_class, present_origin
from lerobot_adamanip.evaluation.text_format import markdown_table
from lerobot_adamanip.util.errors import ConfigurationError

LIMITS = {
    "collection.episodes_per_minute": ("at least", 8.0),
    "observation_ms.raycast.total": ("at most", 15.0),
    "simulator.rendered_by_cast": ("at least", 7.0),
    "action_ms.fast.batch_1": ("at most", 100.0),
}
"""Limits on two CPU cores without a GPU."""
RATES = ("_per_", "rendered_by_cast", "speedup")
"""Parts of names of numbers that are better when larger; the others are times."""
ROOT = Path(__file__).resolve().parents[2]
Numbers = dict[str, Any]


@dataclass
class Bench:
    """Measures speed on this machine: medians of several repeats after a warm-up. Progress on stderr.

    Ratios are of one run, in which both sides take turns, so they hold on a busy machine too; times are this machine's.
    """

    quick: bool = False
    """Fewer episodes and repeats."""

    workers: int = 2
    """Processes that collect."""

    batch_size: int = 64
    """Rows of a training step."""

    device: str = "cpu"
    """Device of the policy: cpu or cuda."""

    category: Category = "safe"
    """Category of the objects."""

    against: str | None = None
    """Revision of this repository, for example HEAD~10: its own `adamanip bench` and this one take turns, and the
    numbers that both have are printed side by side. Needs a checkout with its history."""

    repeats: int = 3
    """With --against: turns of each revision."""

    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> int:
        """Measures and prints; 0, whether or not limits are kept."""
        self._check()
        if self.against is not None:
            report = {"against": self.against, "commit": present_origin().commit, **self._compare(self.against)}
            titles, rows = ["", self.against, "now", "times better"], _compared_rows(report["numbers"])
        else:
            with contextlib.redirect_stdout(sys.stderr):
                report = finish(self._measure())
            titles, rows = ["", "value"], iter([name, str(value)] for name, value in flatten(report).items())
        print(json.dumps(report) if self.json else markdown_table(titles, rows, align=True))
        return 0

    def _check(self) -> None:
        import torch

        wrong = self.device not in ("cpu", "cuda") or (self.device == "cuda" and not torch.cuda.is_available())
        if wrong or min(self.workers, self.batch_size, self.repeats) < 1:
            raise ConfigurationError(
                "Cannot measure that.",
                got=f"--device {self.device} --workers {self.workers} --batch-size {self.batch_size}",
                allowed="cpu, or cuda where there is a GPU; 1 or more",
                hint="adamanip bench --device cpu",
            )

    def _measure(self) -> Numbers:
        from lerobot_adamanip.cli import bench_parts

        logging.getLogger().setLevel(logging.ERROR)
        begin, repeats = time.monotonic(), 3 if self.quick else 7
        results: Numbers = {"commit": present_origin().commit, "machine": _machine()}
        with tempfile.TemporaryDirectory(prefix="adamanip-bench-") as folder:
            root = Path(folder) / "demos"
            policies = bench_parts.Policies(root, self.batch_size, self.device)
            parts: dict[str, Callable[[], Numbers]] = {
                "collection": lambda: bench_parts.collection(
                    root, self.category, per_object=1 if self.quick else 2, workers=self.workers
                ),
                "simulator": lambda: bench_parts.simulator(self.category, 3 * repeats),
                "observation_ms": lambda: bench_parts.observation(self.category, 3 * repeats),
                "training": lambda: policies.training(repeats),
                "action": lambda: policies.action(3 * repeats),
            }
            for name, part in parts.items():
                say(f"[{time.monotonic() - begin:5.0f} s] {name}")
                results[name] = part()
        results["action_ms"] = results.pop("action")
        return {**results, "seconds": round(time.monotonic() - begin, 1)}

    def _compare(self, revision: str) -> Numbers:
        """Returns ``numbers``: dotted name -> medians before and after, and how many times better."""
        options = [f"--category={self.category}", f"--workers={self.workers}", f"--device={self.device}", "--quick"]
        found: dict[str, list[dict[str, float]]] = {"before": [], "after": []}
        with checkout(revision) as old:
            for turn in range(self.repeats):
                for name, tree in (("before", old), ("after", ROOT)):
                    say(f"turn {turn + 1} of {self.repeats}, {name}")
                    found[name].append(_numbers(_bench_of(tree, options)))
        before, after = found["before"], found["after"]
        common = [name for name in after[0] if all(name in each for each in (*before, *after))]
        medians = {
            name: [statistics.median(each[name] for each in turns) for turns in (before, after)] for name in common
        }
        return {
            "numbers": {
                name: {"before": old_, "after": new, "ratio": round(times_better(name, old_, new), 2)}
                for name, (old_, new) in medians.items()
                if old_ and new
            }
        }


def finish(results: Numbers) -> Numbers:
    """Adds ``limits``: name -> value, limit, and whether it is kept."""
    flat = flatten(results)
    limits = {
        name: {
            "value": flat[name],
            "limit": f"{side} {bound:g}",
            "ok": flat[name] >= bound if side == "at least" else flat[name] <= bound,
        }
        for name, (side, bound) in LIMITS.items()
        if name in flat
    }
    return {**results, "limits": limits}


def flatten(results: Numbers, prefix: str = "") -> dict[str, Any]:
    """Returns nested results as dotted names."""
    flat: dict[str, Any] = {}
    for name, value in results.items():
        flat |= flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def times_better(name: str, before: float, after: float) -> float:
    """Returns how many times better a number is after than before, by its name: a rate or a time."""
    return after / before if any(part in name for part in RATES) else before / after


def say(text: str) -> None:
    """Prints progress."""
    print(text, file=sys.stderr, flush=True)


@contextlib.contextmanager
def checkout(revision: str) -> Iterator[Path]:
    """Yields a folder with the sources of a revision; raises `ConfigurationError` if it is not here."""
    with tempfile.TemporaryDirectory(prefix="adamanip-before-") as folder:
        archive = subprocess.run(["git", "archive", revision], cwd=ROOT, capture_output=True, check=False)
        if archive.returncode:
            raise ConfigurationError(
                "This revision is not here.",
                got=f"{revision}: {archive.stderr.decode().strip()}",
                allowed="a revision of the checkout that this command is of",
                hint="git fetch --unshallow",
            )
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        yield Path(folder)


def _bench_of(tree: Path, options: list[str]) -> Numbers:
    """Returns the report of a source tree's own `adamanip bench`, on the installed packages."""
    paths = os.pathsep.join(str(tree / part) for part in ("", "envs", "policies"))
    command = [sys.executable, "-m", "lerobot_adamanip.cli.main", "bench", "--json", *options]
    # Python looks where it is started before it looks along PYTHONPATH.
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run(command, cwd=tree, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise ConfigurationError(
            "A revision cannot be measured.",
            got=f"adamanip bench ended with status {done.returncode} in {tree.name}; its error stands above",
            allowed="a revision that runs on the installed packages",
            hint="--against a newer revision",
        )
    found: Numbers = json.loads(done.stdout.splitlines()[-1])
    return found


def _numbers(report: Numbers) -> dict[str, float]:
    """Returns the measured numbers of a report."""
    flat = flatten({name: value for name, value in report.items() if name not in ("machine", "limits", "seconds")})
    return {
        name: float(value)
        for name, value in flat.items()
        if isinstance(value, int | float) and (any(part in name for part in RATES) or "_ms" in name or ".ms." in name)
    }


def _compared_rows(numbers: Numbers) -> Iterator[list[str]]:
    for name, each in numbers.items():
        yield [name, f"{each['before']:g}", f"{each['after']:g}", f"{each['ratio']:g}"]


def _machine() -> Numbers:
    import torch

    return {**machine_class(), "load": round(os.getloadavg()[0], 2), "torch_threads": torch.get_num_threads()}
