"""Measures this code against an older revision of it, in one run, turn by turn: ``make bench``.

``python scripts/bench_against.py [--against REVISION] [--checkpoint DIR] [--out FILE] [--json]``

The older revision is checked out beside this one and runs on the same installed packages. Every repeat takes the same
seeds in both, one after the other, so a machine that is busy is so for both: ratios hold where times do not. Times of
the simulator are processor time of all threads, as "per core" wants it; rates of commands are by the clock.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from check_common import ROOT, count, header, list_of

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.files import write_atomically

BEFORE = "cf928a8"
"""The last commit before the code was made fast."""
WORKER = ROOT / "scripts" / "speed_worker.py"
PARTS = ("simulator", "collection", "evaluation", "start")
Numbers = dict[str, Any]


class Version:
    """One version of the code: where it lies, and its process that measures.

    Args:
        tree: its sources.
        detail: see `speed_worker.Measured`.
    """

    def __init__(self, tree: Path) -> None:
        self.tree = tree
        paths = os.pathsep.join(str(path) for path in (tree, tree / "envs", tree / "policies"))
        self.environment = {
            **os.environ,
            "PYTHONPATH": paths,
            "HF_HUB_OFFLINE": "1",
            "OMP_NUM_THREADS": "1",
            "TOKENIZERS_PARALLELISM": "false",
        }

    @contextmanager
    def worker(self, *, detail: bool = False) -> Iterator[Any]:
        """Yields a function that asks the worker: takes a request, returns its answer."""
        command = [sys.executable, str(WORKER), *(["--detail"] if detail else [])]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, env=self.environment, text=True) as process:
            assert process.stdin is not None
            assert process.stdout is not None

            def ask(**request: Any) -> Any:
                process.stdin.write(json.dumps(request) + "\n")  # type: ignore[union-attr]
                process.stdin.flush()  # type: ignore[union-attr]
                if not (line := process.stdout.readline()):  # type: ignore[union-attr]
                    raise SystemExit(f"The worker of {self.tree.name} ended; its error stands above.")
                return json.loads(line)

            yield ask
            process.stdin.close()

    def run(self, *command: str, threads: bool = False) -> tuple[float, str]:
        """Runs a command of the installed packages on this version; returns its seconds and what it printed."""
        environment = {
            name: value for name, value in self.environment.items() if not threads or name != "OMP_NUM_THREADS"
        }
        begin = time.perf_counter()
        # Python looks where it is started before it looks along PYTHONPATH.
        done = subprocess.run(command, cwd=self.tree, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{' '.join(command)} failed on {self.tree.name}:\n{done.stderr[-3000:]}")
        return time.perf_counter() - begin, done.stdout


@contextmanager
def checkout(revision: str) -> Iterator[Path]:
    """Yields a folder with the sources of a revision."""
    with tempfile.TemporaryDirectory(prefix="adamanip-before-") as folder:
        archive = subprocess.run(["git", "archive", revision], cwd=ROOT, capture_output=True, check=False)
        if archive.returncode:
            raise SystemExit(
                f"Revision {revision} is not here: {archive.stderr.decode().strip()}\n"
                "  try: a clone with its history (git fetch --unshallow), or --against another revision"
            )
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        yield Path(folder)


def median(values: list[float]) -> float:
    """Returns the median, to four digits."""
    return float(f"{statistics.median(values):.4g}")


def pair(before: list[float], after: list[float], *, rate: bool = False) -> Numbers:
    """Returns medians, the ratio that says how many times better, and all values."""
    one, other = median(before), median(after)
    ratio = other / one if rate else one / other
    return {"before": one, "after": other, "ratio": round(ratio, 2), "repeats": {"before": before, "after": after}}


def simulator(old: Version, new: Version, categories: tuple[str, ...], repeats: int) -> Numbers:
    """Returns category -> control tick [us], reset [ms], cloud [ms], key frames per second and core."""
    found: Numbers = {}
    with old.worker() as ask_old, new.worker() as ask_new:
        for category in categories:
            for ask in (ask_old, ask_new):
                ask(do="open", category=category)
            turns = []
            for repeat in range(repeats):
                seeds = [100 + 2 * repeat, 101 + 2 * repeat]
                turns.append(tuple(_quantities(ask(do="measure", seeds=seeds)) for ask in (ask_old, ask_new)))
            found[category] = {
                name: pair([turn[0][name] for turn in turns], [turn[1][name] for turn in turns], rate="per" in name)
                for name in turns[0][0]
            }
            ratios = {name: values["ratio"] for name, values in found[category].items()}
            say(f"{category}: " + ", ".join(f"{name} {ratio:g} x" for name, ratio in ratios.items()))
    return found


def _quantities(answer: Numbers) -> dict[str, float]:
    seconds, calls = answer["seconds"], answer["calls"]
    return {
        "tick_us": 1e6 * seconds["execute"] / calls["_tick"],
        "reset_ms": 1e3 * seconds["reset"] / calls["reset"],
        "cloud_ms": 1e3 * seconds["cloud"] / calls["cloud"],
        "key_frames_per_core_second": calls["execute"] / answer["cpu"],
    }


def breakdown(new: Version, categories: tuple[str, ...]) -> Numbers:
    """Returns category -> where a control tick of this code goes [us], down to physics alone."""
    found: Numbers = {}
    with new.worker(detail=True) as ask:
        for category in categories:
            ask(do="open", category=category)
            answer = ask(do="measure", seeds=[100, 101, 102])
            seconds, ticks = answer["seconds"], answer["calls"]["_tick"]
            parts = {
                name: round(1e6 * seconds[name] / ticks, 1)
                for name in ("physics", "inverse kinematics", "mechanism", "lag")
            }
            whole = 1e6 * seconds["execute"] / ticks
            found[category] = {**parts, "rest": round(whole - sum(parts.values()), 1), "whole": round(whole, 1)}
    return found


def _collect(version: Version, folder: str, *arguments: str) -> tuple[float, str]:
    """Returns how long `adamanip collect` took to record safes into ``folder`` [s], and what it printed."""
    command = ("-m", "lerobot_adamanip.cli.main", "collect", f"{folder}/demos", "--category", "safe")
    return version.run(sys.executable, *command, *arguments, "--json")


class Watch:
    """Looks for the first file that matches, from another thread.

    Attributes:
        seconds: from the start until it was there; infinite if it never was.
    """

    def __init__(self, folder: Path, pattern: str) -> None:
        self._folder, self._pattern = folder, pattern
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self.seconds = math.inf

    def __enter__(self) -> None:
        self._begin = time.perf_counter()
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._stopped.wait(0.02):
            if any(self._folder.glob(self._pattern)):
                self.seconds = time.perf_counter() - self._begin
                return


def collection(old: Version, new: Version, repeats: int) -> Numbers:
    """Returns episodes per minute of `adamanip collect`, two workers: with pictures, and clouds alone."""
    kinds = {"pictures": (old, ()), "pictures_now": (new, ()), "clouds_now": (new, ("--no-images",))}
    rates: dict[str, list[float]] = {name: [] for name in kinds}
    for repeat in range(repeats):
        for name, (version, more) in kinds.items():
            # So many episodes that starting hardly counts.
            asked = ("--objects", "0:4", "--episodes-per-object", "10", "--workers", "2", "--seed", str(repeat))
            with tempfile.TemporaryDirectory(prefix="adamanip-bench-") as folder:
                _, printed = _collect(version, folder, *asked, *more)
            rates[name].append(json.loads(printed.splitlines()[-1])["episodes_per_minute"])
        say("collection: " + ", ".join(f"{name} {values[-1]:.0f}/min" for name, values in rates.items()))
    before = rates["pictures"]
    return {
        "with_pictures_per_minute": pair(before, rates["pictures_now"], rate=True),
        "clouds_only_per_minute": pair(before, rates["clouds_now"], rate=True),
    }


def evaluation(old: Version, new: Version, checkpoint: Path, repeats: int, episodes: int) -> Numbers:
    """Returns episodes per minute of `lerobot-eval`, as it reports them: one environment, videos of the first ten."""
    rates: dict[str, list[float]] = {"before": [], "after": []}
    for repeat in range(repeats):
        for name, version in (("before", old), ("after", new)):
            with tempfile.TemporaryDirectory(prefix="adamanip-bench-") as folder:
                version.run(
                    sys.executable,
                    "-m",
                    "lerobot.scripts.lerobot_eval",
                    f"--policy.path={checkpoint}",
                    "--policy.device=cpu",
                    "--env.type=adamanip_safe",
                    "--env.objects=0:4",
                    "--env.split=validation",
                    "--env.observe_images=false",
                    f"--eval.n_episodes={episodes}",
                    "--eval.batch_size=2",
                    f"--seed={1000 + repeat}",
                    f"--output_dir={folder}/eval",
                    threads=True,
                )
                told = json.loads((Path(folder) / "eval" / "eval_info.json").read_text(encoding="utf-8"))
            rates[name].append(60.0 / _per_episode(told))
        say("evaluation: " + ", ".join(f"{name} {values[-1]:.1f}/min" for name, values in rates.items()))
    return {"episodes_per_minute": pair(rates["before"], rates["after"], rate=True)}


def _per_episode(told: Numbers) -> float:
    return float(told["overall"]["eval_ep_s"])


def start(old: Version, new: Version, repeats: int) -> Numbers:
    """Returns seconds from the command until one episode is safe on disk, and until the dataset is written."""
    first: dict[str, list[float]] = {"before": [], "after": []}
    whole: dict[str, list[float]] = {"before": [], "after": []}
    for _ in range(repeats):
        for name, version, more in (("before", old, ()), ("after", new, ("--no-images",))):
            with tempfile.TemporaryDirectory(prefix="adamanip-bench-") as folder:
                watch = Watch(Path(folder), "*.partial/episodes/*.safetensors")
                with watch:
                    took, _ = _collect(version, folder, "--objects", "0:1", "--episodes-per-object", "1", *more)
            first[name].append(watch.seconds)
            whole[name].append(took)
        say(f"start: first episode {first['before'][-1]:.1f} s, {first['after'][-1]:.1f} s")
    return {
        "first_episode_s": pair(first["before"], first["after"]),
        "one_episode_s": pair(whole["before"], whole["after"]),
    }


def summary(report: Numbers) -> Numbers:
    """Returns the simulator's means over categories: of times, and of their ratios."""
    rows = report["simulator"]
    means = {}
    for name in next(iter(rows.values())):
        before, after = (statistics.mean(row[name][when] for row in rows.values()) for when in ("before", "after"))
        ratio = after / before if "per" in name else before / after
        means[name] = {"before": round(before, 1), "after": round(after, 1), "ratio": round(ratio, 2)}
    return means


def begun(path: Path | None, report: Numbers) -> Numbers:
    """Returns the report that a run of the same code, against the same revision, has begun; or the one given."""
    if path is None or not path.is_file():
        return report
    found: Numbers = json.loads(path.read_text(encoding="utf-8"))
    alike = all(found.get(name) == report[name] for name in ("fingerprint", "versions", "against", "repeats"))
    return found if alike else report


def say(text: str) -> None:
    """Progress."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def arguments() -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", default=BEFORE, metavar="REVISION", help="what to measure against (%(default)s)")
    parser.add_argument("--categories", type=list_of(tuple(CATEGORIES)), default=tuple(CATEGORIES))
    parser.add_argument("--parts", type=list_of(PARTS), default=PARTS, help=", ".join(PARTS))
    parser.add_argument("--repeats", type=count, default=5, help="of everything (%(default)s)")
    parser.add_argument("--checkpoint", type=Path, help="folder of a dp3_adaptive policy of safes, for the evaluation")
    parser.add_argument("--episodes", type=count, default=10, help="of an evaluation (%(default)s)")
    parser.add_argument("--out", type=Path, help="file to write the report to, after each part; goes on with it")
    parser.add_argument("--json", action="store_true", help="print the report")
    return parser.parse_args()


def main() -> int:
    """Measures, prints and keeps."""
    options = arguments()
    report = begun(options.out, {**header(), "against": options.against, "repeats": options.repeats})
    with ExitStack() as stack:
        old, new = Version(stack.enter_context(checkout(options.against))), Version(ROOT)
        parts = {
            "simulator": lambda: simulator(old, new, options.categories, options.repeats),
            "collection": lambda: collection(old, new, options.repeats),
            "start": lambda: start(old, new, options.repeats),
        }
        if options.checkpoint is not None:
            parts["evaluation"] = lambda: evaluation(
                old, new, options.checkpoint.resolve(), options.repeats, options.episodes
            )
        for name in (name for name in options.parts if name in parts and name not in report):
            report[name] = parts[name]()
            if name == "simulator":
                report["means"], report["tick_us"] = summary(report), breakdown(new, options.categories)
            if options.out is not None:
                write_atomically(options.out, (json.dumps(report, indent=1) + "\n").encode())
    sys.stdout.write(json.dumps(report) + "\n" if options.json else f"{json.dumps(report.get('means'), indent=1)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
