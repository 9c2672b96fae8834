"""`adamanip doctor`: what is installed, what can render, and what to do about what is missing."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import sys
from dataclasses import dataclass
from typing import TextIO

from lerobot_adamanip.cli.doctor.checks import Check, run_checks


@dataclass
class Doctor:
    """Checks this machine for everything the environments, the demonstrations and the policy need.

    Exit status 0 if all required checks pass, 1 if not.
    """

    json: bool = False
    """Print {"checks": [{name, ok, required, found, advice}], "ok": bool} instead of the table."""

    def run(self) -> int:
        """Runs all checks; 0 if every required one passes."""
        out, findings = sys.stdout, []
        with contextlib.redirect_stdout(sys.stderr):  # what imported packages print must not get into the JSON
            for check in run_checks():
                findings.append(check)
                if not self.json:
                    print_check(check, out)
        ok = all(check.ok for check in findings if check.required)
        if self.json:
            print(to_json(findings, ok))
        else:
            print_advice(findings, ok)
        return 0 if ok else 1


def to_json(findings: list[Check], ok: bool) -> str:
    """The machine's version; advice only where something is wrong."""
    rows = [dataclasses.asdict(check) | {"advice": "" if check.ok else check.advice} for check in findings]
    return json.dumps({"checks": rows, "ok": ok}, indent=2)


def print_check(check: Check, out: TextIO) -> None:
    """A line for a person, as soon as it is known: some checks take seconds."""
    mark = "ok" if check.ok else "FAIL" if check.required else "note"
    print(f"{mark:<4}  {check.name:<22}  {check.found}", file=out, flush=True)


def print_advice(findings: list[Check], ok: bool) -> None:
    """What to do about what is missing, for a person."""
    for check in findings:
        if not check.ok:
            print(f"\n{check.name}: {check.advice}")
    rendering = [check for check in findings if check.name == "SAPIEN renders" and not check.ok]
    without = "; this machine renders no pictures, see above" if rendering else ""
    print(f"\neverything required is there{without}" if ok else "\nrequired checks failed: see above")
