"""Writes docs/speed.md from results/bench/against.json and policy.json: ``python scripts/speed_page.py [--check]``.

The first is a report of bench_against.py, the second of ``adamanip bench --json``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from check_common import ROOT, document_command

from lerobot_adamanip.cli.bench.timing import ratio

PAGE, BENCH = ROOT / "docs" / "speed.md", ROOT / "results" / "bench"
REPORT, POLICY = BENCH / "against.json", BENCH / "policy.json"
DEMO_STEPS = {"diffusion": 1800, "fast": 2400}
"""Preset -> steps that ``make demo`` trains: of 0.1.0, and today."""
NAMES = {
    "tick_us": "control tick, µs of processor time",
    "reset_ms": "reset, ms of processor time",
    "cloud_ms": "cloud of 1,024 points, what is made once an episode included, ms of processor time",
    "key_frames_per_core_second": "key frames with cloud per second and core",
    "with_pictures_per_minute": "`adamanip collect`, two workers, clouds and pictures: episodes a minute",
    "clouds_only_per_minute": "the same, clouds alone",
    "episodes_per_minute": "`lerobot-eval` of `dp3_adaptive`, two environments: episodes a minute",
    "first_episode_s": "`adamanip collect`, from command to the first episode on disk, s",
    "one_episode_s": "`adamanip collect` of one episode, from command to dataset, s",
}


def page(report: dict[str, Any], policy: dict[str, Any]) -> str:
    """Returns the document of a report of `bench_against.py`, and one of ``adamanip bench``."""
    lines = [
        "# Speed",
        "",
        f"Made by `scripts/speed_page.py` from a run of `scripts/bench_against.py` (part of `make bench`): commit "
        f"`{(report['commit'] or 'unknown')[:7]}` against `{report['against'][:7]}`, the last one before the code was "
        f"made fast, turn by turn on one machine of two cores, medians of {report['repeats']} repeats. Ratios hold "
        "elsewhere, times do not.",
        "",
    ]
    lines += [*_against(report), *_policy(policy)]
    if "simulator" in report:
        lines += _categories(report)
    return "\n".join(lines) + "\n"


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _against(report: dict[str, Any]) -> list[str]:
    found = {**report.get("means", {})}
    for part in ("collection", "evaluation", "start"):
        found.update(report.get(part, {}))
    rows = [_row(NAMES[name], row["before"], row["after"], f"{row['ratio']} ×") for name, row in found.items()]
    return [_row("", "before", "after", ""), "|---|---|---|---|", *rows, ""]


def _policy(report: dict[str, Any]) -> list[str]:
    """The default preset beside ``diffusion``, the default of 0.1.0."""
    step = {name: report["training"][name]["ms"]["total"] for name in DEMO_STEPS}
    demo = {name: round(steps * step[name] / 60_000, 1) for name, steps in DEMO_STEPS.items()}
    rows = [
        _row(title, ms["diffusion"], ms["fast"], f"{ratio(ms['diffusion'], ms['fast'])} ×")
        for title, ms in (("a training step of 64, ms", step), ("steps of the demo at that, min", demo))
    ]
    for name, title in (("batch_1", "an action, ms"), ("batch_10", "actions in ten environments at once, ms")):
        found = report["action_against_diffusion"][name]
        rows.append(_row(title, found["plain_ms"], found["ms"], f"{found['speedup']} ×"))
    return [
        "## The policy",
        "",
        f"By one run of `adamanip bench` at commit `{(report['commit'] or 'unknown')[:7]}`, actions in turns: preset "
        "`diffusion`, which was the default of 0.1.0, and preset `fast`. `make demo` of 0.1.0 trained "
        f"{DEMO_STEPS['diffusion']:,} steps, today's trains {DEMO_STEPS['fast']:,}.",
        "",
        _row("", "diffusion", "fast", ""),
        "|---|---|---|---|",
        *rows,
        "",
    ]


def _categories(report: dict[str, Any]) -> list[str]:
    names = list(next(iter(report["simulator"].values())))
    lines = ["## By category", "", "The first four rows above are means of these.", ""]
    lines += [_row("category", *(NAMES[name] for name in names)), "|---" * (len(names) + 1) + "|"]
    for category, row in report["simulator"].items():
        cells = (f"{row[name]['before']} → {row[name]['after']} ({row[name]['ratio']} ×)" for name in names)
        lines.append(_row(category, *cells))
    parts = list(next(iter(report["tick_us"].values())))
    lines += [
        "",
        "## Where a control tick goes",
        "",
        "µs of processor time, the timers' own included. Physics alone is the limit; the rest is ours.",
        "",
        _row("category", *parts),
        "|---" * (len(parts) + 1) + "|",
    ]
    lines += [_row(category, *row.values()) for category, row in report["tick_us"].items()]
    return lines


def read(path: Path) -> dict[str, Any]:
    """Returns a report."""
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def main() -> int:
    """Writes the page, or says that it is not what it would be."""
    return document_command(__doc__, lambda: {PAGE: page(*map(read, (REPORT, POLICY)))})


if __name__ == "__main__":
    sys.exit(main())
