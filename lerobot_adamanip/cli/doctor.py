"""`adamanip doctor`: checks installation and rendering, and prints fixes."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import sys
from dataclasses import dataclass

from lerobot_adamanip.cli.doctor_checks import Check, run_checks


@dataclass
class Doctor:
    """Check this machine for everything that the environments, the datasets and the policies need.

    Exit status 0 if all required checks pass, 1 if not.
    """

    json: bool = False
    """Print {"checks": [{name, ok, required, found, advice}], "ok": bool} instead of the table."""

    def run(self) -> int:
        """Runs all checks. Returns 0 if every required check passes."""
        out, checks = sys.stdout, list[Check]()
        with contextlib.redirect_stdout(sys.stderr):  # imported packages may print, but stdout is for the result
            for check in run_checks():
                checks.append(check)
                if not self.json:  # print at once, since some checks take seconds
                    mark = "ok" if check.ok else "FAIL" if check.required else "note"
                    print(f"{mark:<4}  {check.name:<22}  {check.found}", file=out, flush=True)
        ok = all(check.ok for check in checks if check.required)
        if self.json:
            rows = [dataclasses.asdict(check) | {"advice": "" if check.ok else check.advice} for check in checks]
            print(json.dumps({"checks": rows, "ok": ok}, indent=2))
        else:
            print_advice(checks, ok)
        return 0 if ok else 1


def print_advice(checks: list[Check], ok: bool) -> None:
    """Prints how to fix each failed check, and a summary."""
    failed = [check for check in checks if not check.ok]
    for check in failed:
        print(f"\n{check.name}: {check.advice}")
    pictures = "; this machine renders no pictures, see above" if "SAPIEN renders" in [c.name for c in failed] else ""
    print(f"\nall required checks passed{pictures}" if ok else "\nrequired checks failed: see above")
