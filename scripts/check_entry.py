"""Checks an entry of the leaderboard: ``python scripts/check_entry.py results/leaderboard/NAME [--evaluate]``.

With ``--evaluate`` it trains and evaluates the entry again, under ``--out``, and compares each cell. A checkpoint on
the Hub is only evaluated. Exits 1 if a cell differs. On another machine, torch rounds otherwise: trainings differ.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

from lerobot_adamanip.benchmark.command import find_program
from lerobot_adamanip.benchmark.leaderboard import DECLARATION, SCALES, SEED, read_entry
from lerobot_adamanip.benchmark.report import opened, within
from lerobot_adamanip.evaluation.results import ResultFile, read_result
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError


def main() -> int:
    """Checks the entry. Returns 0 on success, 1 if a cell differs, 2 if it is not an entry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("entry", type=Path)
    parser.add_argument("--evaluate", action="store_true", help="train and evaluate again")
    parser.add_argument("--out", type=Path, default=Path("outputs/entry"))
    parser.add_argument("--json", action="store_true", help="print one JSON line")
    options = parser.parse_args()
    try:
        entry = read_entry(options.entry)
        if options.evaluate and options.out.exists():
            raise ConfigurationError(
                "An entry is evaluated in a new folder.",
                got=options.out,
                allowed="a folder that does not exist",
                hint="another --out",
            )
        program = find_program("adamanip") if options.evaluate else ""
    except AdaManipError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    lines = []
    for scale in SCALES:
        cells = entry.results[scale]
        if options.evaluate:
            name = next(iter(cells)).method
            command = [program, "benchmark", "--config", str(options.entry / DECLARATION), "--scale", scale]
            # Status 1: a cell failed. The others can be compared.
            command += ["--methods", name, "--seeds", str(SEED), "--out", str(options.out)]
            subprocess.run(command, check=False, stdout=sys.stderr)
        for cell, published in cells.items():
            line = {"scale": scale, "cell": cell.name, "published": _text(published)}
            if options.evaluate:
                path = options.out / scale / "cells" / f"{cell.name}.json"
                again = read_result(path) if path.exists() else None
                line["again"] = _text(again) if again else "failed"
                line["differs in"] = _differing(published, again) if again else "everything"
            lines.append(line)
    sys.stdout.write(
        json.dumps(lines) + "\n" if options.json else "".join(f"{' | '.join(each.values())}\n" for each in lines)
    )
    return int(any(line.get("differs in") for line in lines))


def _text(result: ResultFile) -> str:
    metrics = result.rows[0].metrics
    counts = [share.count if share else "-" for share in (opened(metrics), within(metrics))]
    return f"opened {counts[0]}, within {counts[1]} of {metrics.success.episodes}"


def _differing(published: ResultFile, again: ResultFile) -> str:
    """Returns the measured fields in which two results of a cell differ; empty if they agree."""
    rows = [one.rows[0].to_json() for one in (published, again)]
    return ", ".join(name for name, value in rows[0].items() if value != rows[1][name])


if __name__ == "__main__":
    sys.exit(main())
