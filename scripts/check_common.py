"""Shared code of the check scripts: report header, options, processes, progress."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lerobot_adamanip.cli.progress import ProgressLines
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.versions import SIMULATION_VERSION, installed_versions
from lerobot_adamanip.evaluation.provenance import present_origin
from lerobot_adamanip.util.errors import AdaManipError, UnreachableError

ROOT = Path(__file__).resolve().parents[1]
BATCH = 20
"""Number of scenes per simulator start."""


def header() -> dict[str, Any]:
    """Returns the header of a report: command, commit if any, and versions."""
    return {
        "command": shlex.join(["python", *sys.argv]),
        "commit": present_origin().commit,
        "simulation_version": SIMULATION_VERSION,
        "versions": dict(installed_versions()),
    }


def document_command(description: str | None, wanted: Callable[[], Mapping[Path, str]]) -> int:
    """Writes generated documents, or with ``--check`` lists the outdated ones. Returns the exit status.

    Args:
        description: description of the command line.
        wanted: returns document -> text.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a document would change")
    options = parser.parse_args()
    try:
        texts = wanted()
    except AdaManipError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    stale = [path for path, text in texts.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    for path in stale:
        if not options.check:
            path.write_text(texts[path], encoding="utf-8")
        sys.stdout.write(f"{'stale' if options.check else 'written'}: {path.relative_to(ROOT)}\n")
    return 1 if options.check and stale else 0


def count(text: str) -> int:
    """Parses a whole number >= 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return value


def list_of(allowed: tuple[str, ...] | None) -> Callable[[str], tuple[str, ...]]:
    """Returns a parser of comma-separated names from ``allowed``; None allows all."""

    def parse(text: str) -> tuple[str, ...]:
        chosen = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
        if allowed is not None and (unknown := [name for name in chosen if name not in allowed]):
            raise argparse.ArgumentTypeError(f"{', '.join(unknown)} is none of {', '.join(allowed)}")
        return chosen

    return parse


def parser(description: str | None, *, seeds: int, first_seed: int) -> argparse.ArgumentParser:
    """Returns a command line with options for categories, seeds, processes and JSON."""
    options = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--category", choices=(*CATEGORIES, ALL), default=ALL, help="category, or all (%(default)s)")
    options.add_argument("--seeds", type=count, default=seeds, help="scenes per category (%(default)s)")
    options.add_argument("--first-seed", type=count, default=first_seed, help="seed of the first scene (%(default)s)")
    options.add_argument("--workers", type=count, default=1, help="processes; each needs about 2 GB (%(default)s)")
    options.add_argument("--json", action="store_true", help="print JSON instead of text")
    return options


def run_seeds[Result](
    check: Callable[..., Result], options: argparse.Namespace, *more: Any, **task_options: Any
) -> dict[str, list[Result]]:
    """Runs `check_scenes` in processes, for the options of `parser`. Returns category -> results."""
    names = tuple(CATEGORIES) if options.category == ALL else (options.category,)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    batches = [(name, part, check, more, task_options) for name in names for part in in_batches(seeds)]
    results: dict[str, list[Result]] = {name: [] for name in names}
    for (name, *_), part in run_parallel(check_scenes, batches, options.workers, len(names) * options.seeds):
        results[name] += part
    return results


def check_scenes[Result](
    category: str,
    seeds: Iterable[int],
    check: Callable[..., Result],
    more: tuple[Any, ...] = (),
    task_options: Mapping[str, Any] = MappingProxyType({}),
) -> list[Result]:
    """Runs ``check(task, seed, *more)`` on each seed in one simulator. Skips seeds without a placed object."""
    from lerobot_env_adamanip.simulator import make_task

    warnings.filterwarnings("ignore")
    results = []
    with contextlib.closing(make_task(category, **task_options)) as task:
        for seed in seeds:
            with contextlib.suppress(UnreachableError):
                results.append(check(task, seed, *more))
    return results


def print_reports(reports: list[dict[str, Any]], lines: Iterable[str], options: argparse.Namespace) -> int:
    """Prints a report per category, as JSON or as lines. Returns 0 if all have passed."""
    sys.stdout.write((json.dumps(reports) if options.json else "\n".join(lines)) + "\n")
    return 0 if all(report["passed"] for report in reports) else 1


def in_batches[Item](items: Sequence[Item]) -> list[list[Item]]:
    """Returns the items in batches, one per simulator start."""
    return [list(items[start : start + BATCH]) for start in range(0, len(items), BATCH)]


def run_parallel[Result](
    work: Callable[..., list[Result]], batches: Iterable[tuple[Any, ...]], workers: int, total: int
) -> Iterator[tuple[tuple[Any, ...], list[Result]]]:
    """Yields each batch and the result of ``work(*batch)`` from single-threaded processes; ``total`` episodes."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    show, done = ProgressLines({"episodes": "episodes"}), 0
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            jobs = {pool.submit(work, *batch): batch for batch in batches}
            for job in as_completed(jobs):
                done += len(job.result())
                show("episodes", done, total)
                yield jobs[job], job.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
