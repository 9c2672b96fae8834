"""Publishes a benchmark's policies, their training data and the environments: ``make publish USER=you``.

Of each category: the dataset of a method's last training, and its checkpoint, whose card has the results on seen,
unseen and novel objects. After an interruption, the same command resumes. For example:

    adamanip benchmark --config lerobot_adamanip/benchmark/default_policy.toml --scale test --methods corrected
    python scripts/publish.py --user you --dry-run
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from check_common import list_of

from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS
from lerobot_adamanip.benchmark.plan import COLLECT, EVALUATE, FOLDERS, MERGE, TRAIN, last_checkpoint
from lerobot_adamanip.benchmark.result import CellResult, read_cell
from lerobot_adamanip.cli.push import PushCommand
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.provenance import Origin
from lerobot_adamanip.evaluation.results import ResultFile, ResultRow, write_result
from lerobot_adamanip.evaluation.text_format import markdown_table
from lerobot_adamanip.util.errors import AdaManipError, DatasetError


def results_of(root: Path, method: str, category: str, seed: int) -> list[CellResult]:
    """Returns the results of a policy, that on seen objects first; raises `DatasetError` without that one."""
    paths = [root / "cells" / f"{method}-{category}-{objects}-{seed}.json" for objects in OBJECT_SPLITS]
    if not paths[0].exists():
        raise DatasetError(
            "No result of this policy.",
            got=paths[0],
            allowed="a benchmark's folder with its cells, demonstrations and trainings",
            hint="adamanip benchmark --scale test, or --benchmark FOLDER",
        )
    return [read_cell(path) for path in paths if path.exists()]


def result_file(cell: CellResult) -> ResultFile:
    """Returns a cell's result in the form that cards show."""
    rules = cell.evaluation_options["--env.mechanism_rules"]
    row = ResultRow(cell.title, rules, cell.cell.category, cell.cell.objects, cell.numbers)
    return ResultFile(
        **{each.name: getattr(cell, each.name) for each in fields(Origin)},
        kind="policy",
        title=f"benchmark, scale {cell.scale}, training seed {cell.cell.seed}",
        command=cell.steps[EVALUATE].command,
        simulation_version=cell.simulation_version,
        machine=cell.costs[EVALUATE].machine,
        scenes=cell.scenes,
        seeds=cell.scene_seeds,
        seconds=cell.costs[EVALUATE].seconds,
        rows=(row,),
    )


def publications(options: argparse.Namespace, scratch: Path) -> Iterator[PushCommand]:
    """Yields what is to be published; writes the results of the cards into ``scratch``."""
    shared = {"private": options.private, "dry_run": options.dry_run}
    for category in options.categories:
        cells = results_of(options.benchmark, options.method, category, options.seed)
        steps = {kind: [name for name in cells[0].steps if name.partition("_")[0] == kind] for kind in FOLDERS}
        data, training = (steps[MERGE] or steps[COLLECT])[-1], steps[TRAIN][-1]
        folders = {
            name: options.benchmark / FOLDERS[name.partition("_")[0]] / cells[0].steps[name].key
            for name in (data, training)
        }
        dataset, model = (f"{options.user}/{kind}-{category.replace('_', '-')}" for kind in ("adamanip", options.name))
        yield PushCommand("dataset", dataset, folders[data], **shared)
        files = []
        for cell in cells:
            files.append(scratch / f"{cell.cell.name}.json")
            write_result(files[-1], result_file(cell))
        yield PushCommand("model", model, last_checkpoint(folders[training]), tuple(files), dataset=dataset, **shared)
    yield PushCommand("environment", f"{options.user}/adamanip", **shared)


def main(arguments: Sequence[str] | None = None) -> int:
    """Publishes and prints sizes and times. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--user", required=True, help="user or organisation on the Hub")
    parser.add_argument("--benchmark", type=Path, default=Path("outputs/benchmark/test"), help="folder of a scale")
    parser.add_argument("--method", default="corrected")
    parser.add_argument("--name", default="dp3-adaptive", help="beginning of the policies' names")
    parser.add_argument("--seed", type=int, default=1000, help="of the trainings")
    parser.add_argument("--categories", type=list_of(tuple(CATEGORIES)), default=tuple(CATEGORIES))
    parser.add_argument("--private", action="store_true")
    parser.add_argument("--dry-run", action="store_true", help="check all files, send nothing")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    try:
        with tempfile.TemporaryDirectory() as scratch:
            for each in publications(options, Path(scratch)):
                begin = time.perf_counter()
                sizes, result, _ = each.publish()
                seconds = round(time.perf_counter() - begin, 1)
                sent, total = {} if result is None else asdict(result), sum(sizes.values())
                rows.append({**sent, "kind": each.kind, "repo_id": each.repo_id, "bytes": total, "seconds": seconds})
                sys.stderr.write(f"{each.repo_id}: {len(sizes)} files, {total / 1e6:.1f} MB, {seconds} s\n")
    except AdaManipError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    lines = [[row["kind"], row["repo_id"], f"{row['bytes'] / 1e6:.1f}", f"{row['seconds']:.0f}"] for row in rows]
    table = markdown_table(["kind", "name", "MB", "seconds"], lines)
    sys.stdout.write(f"{json.dumps(rows) if options.json else table}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
