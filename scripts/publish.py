"""Publishes a benchmark's policies, their training data and the environments: ``make publish USER=you``.

For each category: the dataset of a method's last training, and its checkpoint. The checkpoint's card has the results
on seen, unseen and novel objects. After an interruption, the same command resumes. For example:

    adamanip benchmark --config lerobot_adamanip/benchmark/default_policy.toml --scale test --methods dp3_adaptive
    python scripts/publish.py --user you --dry-run
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from check_common import list_of

from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS
from lerobot_adamanip.benchmark.plan import FOLDERS, TRAIN, last_checkpoint
from lerobot_adamanip.benchmark.report import last_training
from lerobot_adamanip.cli.push import PushCommand
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.results import CellRun, command_options, read_result
from lerobot_adamanip.evaluation.text_format import markdown_table
from lerobot_adamanip.util.errors import AdaManipError, DatasetError

DECLARED = "lerobot_adamanip/benchmark/default_policy.toml"
NAME = "dp3-adaptive"


def result_paths(root: Path, method: str, category: str, seed: int) -> tuple[Path, ...]:
    """Returns the result files of a policy, that on seen objects first; raises `DatasetError` without that one."""
    paths = [root / "cells" / f"{method}-{category}-{objects}-{seed}.json" for objects in OBJECT_SPLITS]
    if not paths[0].exists():
        raise DatasetError(
            "No result of this policy.",
            got=paths[0],
            allowed="a benchmark's folder with its cells, demonstrations and trainings",
            hint=f"adamanip benchmark --config {DECLARED} --scale test, or --benchmark FOLDER",
        )
    return tuple(path for path in paths if path.exists())


def run_of(paths: Sequence[Path]) -> CellRun:
    """Returns the run behind results of one training; raises `DatasetError` if they are of several, or of none."""
    runs = {}
    for path in paths:
        result = read_result(path)
        if result.run is None or not (last := last_training(result.run)):
            raise DatasetError(
                "A result of no training.",
                got=path,
                allowed="results of a trained method",
                hint="--method dp3_adaptive",
            )
        runs.setdefault((result.run.steps[last].key, result.simulation_version, result.run.data_version), result.run)
    if len(runs) > 1:
        kinds = (f"{key} (simulation version {one}, data version {other})" for key, one, other in runs)
        raise DatasetError(
            "The results of a checkpoint are of several trainings or versions.",
            got=f"{', '.join(path.name for path in paths)}: {'; '.join(kinds)}",
            allowed="results of one training, simulation version and data version",
            hint="the same `adamanip benchmark` command again, which replaces stale results",
        )
    return next(iter(runs.values()))


def publications(options: argparse.Namespace) -> Iterator[PushCommand]:
    """Yields the publications: dataset and checkpoint of each category, then the environments."""
    shared = {"private": options.private, "dry_run": options.dry_run}
    for category in options.categories:
        results = result_paths(options.benchmark, options.method, category, options.seed)
        run = run_of(results)
        step = run.steps[last_training(run)]
        training = options.benchmark / FOLDERS[TRAIN] / step.key
        data = options.benchmark / command_options(step.command)["--dataset.root"]
        data_name = "adamanip" if options.name == NAME else f"adamanip-{options.name}"
        dataset, model = (f"{options.user}/{kind}-{category.replace('_', '-')}" for kind in (data_name, options.name))
        yield PushCommand("dataset", dataset, data, **shared)
        yield PushCommand("model", model, last_checkpoint(training), results, dataset=dataset, **shared)
    yield PushCommand("environment", f"{options.user}/adamanip", **shared)


def main(arguments: Sequence[str] | None = None) -> int:
    """Publishes and prints sizes and times. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--user", required=True, help="user or organisation on the Hub")
    parser.add_argument("--benchmark", type=Path, default=Path("outputs/benchmark/test"), help="folder of a scale")
    parser.add_argument("--method", default="dp3_adaptive")
    parser.add_argument("--name", default=NAME, help="beginning of the policies' names; datasets of others have it too")
    parser.add_argument("--seed", type=int, default=1000, help="of the trainings")
    parser.add_argument("--categories", type=list_of(tuple(CATEGORIES)), default=tuple(CATEGORIES))
    parser.add_argument("--private", action="store_true")
    parser.add_argument("--dry-run", action="store_true", help="check all files, send nothing")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    try:
        for push in list(publications(options)):  # all are known before the first is sent
            begin = time.perf_counter()
            sizes, result, _ = push.publish()
            seconds = round(time.perf_counter() - begin, 1)
            sent, total = {} if result is None else asdict(result), sum(sizes.values())
            rows.append({**sent, "kind": push.kind, "repo_id": push.repo_id, "bytes": total, "seconds": seconds})
            sys.stderr.write(f"{push.repo_id}: {len(sizes)} files, {total / 1e6:.1f} MB, {seconds} s\n")
    except AdaManipError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    lines = [[row["kind"], row["repo_id"], f"{row['bytes'] / 1e6:.1f}", f"{row['seconds']:.0f}"] for row in rows]
    table = markdown_table(["kind", "name", "MB", "seconds"], lines)
    sys.stdout.write(f"{json.dumps(rows) if options.json else table}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
