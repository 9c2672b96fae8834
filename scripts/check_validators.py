"""Runs five third-party dataset validators: ``python scripts/check_validators.py DIR [--out DIR]``.

They are installed from the package index into an environment of their own, ``OUT/venv``. A finding that stands in
`EXPECTED` is printed with its reason; any other one makes the script return 1.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import venv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PACKAGES = (
    "robovet==0.2.2", "rdq==0.3.4", "adduct==0.2.2", "lerobot-doctor==0.2.0", "lerobot-quality-gates==0.1.7",
)  # fmt: skip
TIMEOUT_S = 600
EXPECTED: dict[tuple[str, str], str] = {
    ("rdq", "much shorter than usual"): "an episode that meets no failure is short",
    ("rdq", "short glitches"): "rows are key frames: the gripper closes within one",
    ("rdq", "gaps or jumps"): "rows are key frames: the hand moves far within one",
    ("adduct", "contradictory actions"): "nobody can see which way a knob turns: demonstrations try both",
    ("adduct", "sits exactly at the"): "the gripper is open or closed, and a rotation's elements reach 1",
    ("adduct", "mix scales"): "one vector holds positions, angles and velocities; policies normalize each",
    ("adduct", "wander"): "failed tries and what follows them are what the data are for",
    ("adduct", "two distinct styles"): "episodes that meet a failure and recover, and those that meet none",
    ("adduct", "evolves inconsistently"): "a blocked pull does not move the hand",
    ("adduct", "misaligned by"): "rows are key frames: they have no clock",
    ("adduct", "Shaky teleoperation"): "rows are key frames: they have no clock",
    ("lerobot-doctor", "extreme outlier"): "12 of 2,066 rows: a blocked pull strains the arm until the hand slips off",
    ("lerobot-doctor", "values at minimum"): "the gripper is open or closed",
    ("lerobot-doctor", "values at maximum"): "the gripper is open or closed",
    ("lerobot-doctor", "zero variance"): "the column has room for more joints than this object has",
    ("lerobot-doctor", "constant dimension"): "the column has room for more joints than this object has",
    ("lerobot-doctor", "shorter than chunk_size"): "an episode has 6 to 21 key frames; chunks are of 4",
    ("lerobot-doctor", "too short for delta_timestamps"): "an episode has 6 to 21 key frames; chunks are of 4",
    ("lerobot-doctor", "no image/video features"): "pictures are optional (`adamanip render`)",
    ("lerobot-quality-gates", "meta/episodes.json"): "a file of format v2; v3.0 keeps episodes in Parquet",
    ("lerobot-quality-gates", "No camera features"): "pictures are optional (`adamanip render`)",
}  # fmt: skip
"""(validator, part of its message) -> why the finding is no defect."""


@dataclass(frozen=True)
class Finding:
    """A finding above the level of information."""

    validator: str
    message: str

    def reason(self) -> str | None:
        """Returns why this is no defect; None if it is one."""
        matching = (why for (name, part), why in EXPECTED.items() if name == self.validator and part in self.message)
        return next(matching, None)


def robovet(report: Any) -> Iterator[str]:
    """Yields messages of a report of ``robovet doctor --json``."""
    for result in report["results"]:
        if result["severity"] in ("WARN", "FAIL"):
            yield f"{result['check_id']}: {result['summary']}"


def rdq(report: Any) -> Iterator[str]:
    """Yields messages of a report of ``rdq check --json``."""
    for finding in report["findings"]:
        if finding["severity"].lower() != "info":
            yield finding["message"]


def adduct(report: Any) -> Iterator[str]:
    """Yields messages of a report of ``adduct scan --json``."""
    for cluster in report["clusters"]:
        if cluster["severity"] in ("MEDIUM", "HIGH"):
            yield f"{cluster['severity']}: {cluster['title']}"


def lerobot_doctor(report: Any) -> Iterator[str]:
    """Yields messages of a report of ``lerobot-doctor check --json``."""
    for check in report["checks"]:
        for message in check["messages"]:
            if message["severity"] in ("WARN", "FAIL"):
                yield f"{check['name']}: {message['message']}"


def quality_gates(report: Any) -> Iterator[str]:
    """Yields messages of a report of ``lerobot-quality-gates check --format json``."""
    for finding in report["findings"]:
        yield f"{finding['severity']}: {finding['message']} ({finding['path']})"


VALIDATORS = {
    "robovet": (("doctor", "{root}", "--json", "{out}"), robovet),
    "rdq": (("check", "{root}", "--json", "{out}"), rdq),
    "adduct": (("scan", "{root}", "--json", "{out}"), adduct),
    "lerobot-doctor": (("check", "{root}", "--json"), lerobot_doctor),
    "lerobot-quality-gates": (("check", "{root}", "--format", "json", "--out", "{out}"), quality_gates),
}
"""Command -> its arguments, and the reader of its report."""


def install(folder: Path) -> Path:
    """Returns the folder of the validators' commands; makes their environment where it is missing."""
    if not (folder / "installed").exists():
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([folder / "bin" / "python", "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        (folder / "installed").touch()
    return folder / "bin"


def findings(commands: Path, root: Path, out: Path) -> Iterator[Finding]:
    """Yields what each validator finds in a dataset; raises `RuntimeError` if one writes no report."""
    for name, (arguments, read) in VALIDATORS.items():
        report = out / f"{name}.json"
        report.unlink(missing_ok=True)
        command = [str(commands / name), *(text.format(root=root, out=report) for text in arguments)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        if not report.exists():
            report.write_text(ended.stdout, encoding="utf-8")
        try:
            content = json.loads(report.read_text(encoding="utf-8"))
        except json.JSONDecodeError as error:
            raise RuntimeError(f"{name} wrote no report: {ended.stderr[-500:]}") from error
        yield from (Finding(name, message) for message in read(content))


def main(argv: list[str] | None = None) -> int:
    """Runs the script; returns 1 if a validator finds a defect."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path, help="folder of the dataset")
    parser.add_argument("--out", type=Path, default=Path("outputs/validators"), help="folder of the reports")
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    found = list(findings(install(options.out / "venv"), options.root.resolve(), options.out))
    defects = [finding for finding in found if finding.reason() is None]
    lines = [f"{each.validator}: {each.message}\n    {each.reason() or 'DEFECT'}" for each in found]
    lines.append(f"{len(VALIDATORS)} validators, {len(found)} findings, {len(defects)} of them defects")
    sys.stdout.write("\n".join(lines) + "\n")
    return 1 if defects else 0


if __name__ == "__main__":
    sys.exit(main())
