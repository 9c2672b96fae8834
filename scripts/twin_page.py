"""Writes docs/twin_session.md from results/twin/session.json: ``python scripts/twin_page.py [--check]``.

The report is what ``check_twin_session.py --policy ...`` leaves as ``result.json``.
"""

from __future__ import annotations

import json
import shlex
import sys
from typing import Any

from check_common import ROOT, document_command

PAGE, REPORT = ROOT / "docs" / "twin_session.md", ROOT / "results" / "twin" / "session.json"


def page(report: dict[str, Any]) -> str:
    """Returns the document of a report of `check_twin_session.py`."""
    lines = [
        "# A session on the twin",
        "",
        f"Made by `scripts/twin_page.py` from a run of `{report['command']}` at commit "
        f"`{(report['commit'] or 'unknown')[:10]}`, fingerprint `{report['fingerprint']}`, on two cores without a GPU. "
        "What the commands are, and what a twin is: [twin](twin.md).",
        "",
        "| | | wanted |",
        "|---|---|---|",
        *(f"| {what} | {found} | {wanted} |" for what, found, wanted in _findings(report)),
        "",
        "All of it is as wanted." if report["passed"] else "**Not all of it is as wanted.**",
        "",
        "## The commands",
        "",
        "In order, and how long each took; those of one kind in a row are told once.",
        "",
        "```text",
        *_commands(report["commands"]),
        "```",
    ]
    return "\n".join(lines) + "\n"


def _findings(report: dict[str, Any]) -> list[tuple[str, str, str]]:
    learnt, yes = report["learnt"], {True: "yes", False: "no"}
    rows = [
        ("microwaves recorded in lockstep, opened", f"{report['opened']} of {report['episodes']}", "9 of 10"),
        ("of them locked", str(report["locked"]), "both kinds"),
        ("teleoperated in real time", f"{report['teleoperated_s']:.0f} s", "10 s"),
        ("a replay opens the same door", yes[report["replay_opened"]], "yes"),
        ("key frames are described as simulated demonstrations are", yes[learnt["same_description"]], "yes"),
        ("every action is a target that was accepted, in float32", yes[learnt["accepted_targets"]], "yes"),
        (
            "episodes whose key frames, played in their scene, open the door",
            f"{learnt['opened_again']} of {learnt['played_again']}",
            "8 of 10",
        ),
        ("loss of a mixed training", "{} to {}".format(*learnt["loss"]), "falls by half"),
    ]
    if (rolled := report.get("roll_outs")) is not None:
        low, high = (f"{100 * share:.0f} %" for share in rolled["interval"])
        rows.append(
            (
                "roll-outs of a policy on the twin that open the door",
                f"{rolled['rolled_out']} of {rolled['seeds']}",
                f"within {low} to {high}, as `lerobot-eval`: {rolled['evaluated']} of {rolled['seeds']}",
            )
        )
    return rows


def _commands(commands: list[dict[str, Any]]) -> list[str]:
    lines, last, more = [], "", 0
    for each in commands:
        if each["command"][0] == last == "lerobot-rollout":
            more += 1
            continue
        if more:
            lines.append(f"          ... and {more} more, a seed each")
        lines.append(f"{each['seconds']:7.1f} s {shlex.join(each['command'])}")
        last, more = each["command"][0], 0
    return lines


def main() -> int:
    """Writes the page, or says that it is not what it would be."""
    return document_command(__doc__, lambda: {PAGE: page(json.loads(REPORT.read_text(encoding="utf-8")))})


if __name__ == "__main__":
    sys.exit(main())
