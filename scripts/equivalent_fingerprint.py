"""Records that the current code gives the same results as code with another fingerprint.

``python scripts/equivalent_fingerprint.py --old 0579103308de0e2b --shown-by "make demo"`` adds a row to
lerobot_adamanip/evaluation/equivalent_fingerprints.json. Results with that fingerprint then count as current results.
"""

from __future__ import annotations

import argparse
import json
import sys

from lerobot_adamanip.evaluation.provenance import EQUIVALENT
from lerobot_env_adamanip.fingerprint import environment_fingerprint, present_fingerprint


def main() -> None:
    """Adds a row, which replaces an older row of the same fingerprint."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", required=True, help="fingerprint in a result file")
    parser.add_argument("--shown-by", required=True, help="command with identical output for both versions of the code")
    parser.add_argument("--experts", action="store_true", help="the results are of experts, not of policies")
    options = parser.parse_args()
    new = present_fingerprint() if options.experts else environment_fingerprint()
    rows = [row for row in json.loads(EQUIVALENT.read_text(encoding="utf-8")) if row["old"] != options.old]
    rows.append({"old": options.old, "new": new, "shown_by": options.shown_by})
    EQUIVALENT.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(f"{options.old} -> {new}; now: python scripts/make_results.py\n")


if __name__ == "__main__":
    main()
