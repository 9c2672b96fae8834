"""Checks an entry of the leaderboard: ``python scripts/check_entry.py results/leaderboard/NAME [--json]``.

Exits with 1 if the result files break the rule of docs/leaderboard.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from lerobot_adamanip.benchmark.leaderboard import violations
from lerobot_adamanip.benchmark.result import read_cells
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.util.errors import AdaManipError


def main() -> int:
    """Prints what breaks the rule. Returns 0 for an entry that keeps it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of result files")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    try:
        found = list(violations(read_cells(options.folder), SIMULATION_VERSION))
    except AdaManipError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    text = json.dumps({"violations": found}) if options.json else "\n".join(found) or "The entry keeps the rule."
    sys.stdout.write(f"{text}\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
