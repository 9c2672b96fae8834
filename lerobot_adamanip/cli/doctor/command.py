"""`adamanip doctor`: what is installed, what can render, and what to do about what is missing."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import sys
from dataclasses import dataclass

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
        with contextlib.redirect_stdout(sys.stderr):  # what imported packages print must not get into the JSON
            findings = list(run_checks())
        ok = all(check.ok for check in findings if check.required)
        if self.json:
            print(to_json(findings, ok))
        else:
            print_table(findings, ok)
        return 0 if ok else 1


def to_json(findings: list[Check], ok: bool) -> str:
    """The machine's version; advice only where something is wrong."""
    rows = [dataclasses.asdict(check) | {"advice": "" if check.ok else check.advice} for check in findings]
    return json.dumps({"checks": rows, "ok": ok}, indent=2)


def print_table(findings: list[Check], ok: bool) -> None:
    """The human's version: a table, then what to do."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(file=sys.stdout)
    table = Table("", "check", "found", box=None, pad_edge=False)
    for check in findings:
        mark = "[green]ok[/]" if check.ok else "[red]FAIL[/]" if check.required else "[yellow]note[/]"
        table.add_row(mark, check.name, escape(check.found))
    console.print(table)
    for check in findings:
        if not check.ok:
            console.print(f"\n{check.name}: {check.advice}", markup=False, highlight=False)
    console.print("\neverything required is there" if ok else "\nrequired checks failed: see above", markup=False)
