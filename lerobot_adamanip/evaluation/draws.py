"""What a policy draws, as tables: what it would try after so many failures, and how far its motions go.

The reports are those of scripts/check_choices.py and scripts/check_motions.py, a file for each category.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.evaluation.results import check_command
from lerobot_adamanip.evaluation.text_format import markdown_table
from lerobot_adamanip.util import json_fields as checked_json
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import choice, integer, listing, mapping, number, optional, table, text

NO_TRY = "no try"
"""What a draw is called that tries nothing: an approach, a grasp, a release."""
_LINE = text(r"[^\r\n|`<>]{1,600}", "a line of plain text")
_COUNT = integer(0, 10**9)
_HEADER = {
    "command": _LINE,
    "commit": optional(text(r"[0-9a-f]{40}", "a commit")),
    "fingerprint": text(r"[0-9a-f]{16}", "a fingerprint"),
    "versions": mapping(_LINE, _LINE, 60),
    "category": choice(tuple(CATEGORIES)),
}
_AFTER = table(
    {
        "failed": integer(0, 100),
        "draws": mapping(_LINE, _COUNT, 100),
        "repeat_of_tries": number(0, 1),
        "repeat_of_all": number(0, 1),
    }
)
_EPISODES = mapping(text(r"[^\r\n|`<>]{0,200}", "a hidden state"), listing(_COUNT, 2, 2), 100)
CHOICES = table(
    {
        **_HEADER,
        "split": choice(("validation", "test")),
        "after": listing(_AFTER, 1, 100),
        "episodes": _EPISODES,
    }
)
_SPREAD = listing(number(0, 1e6), 3, 3)
_MOTIONS = table({"mm": _SPREAD, "deg": _SPREAD})
_DISTRIBUTIONS = ("demonstrated", "drawn", "nearest")
_PHASE = table({"rows": _COUNT, **dict.fromkeys(_DISTRIBUTIONS, _MOTIONS)})
_PHASE_NAME = choice(tuple(phase.name.lower() for phase in Phase))
MOTIONS = table({**_HEADER, "phases": mapping(_PHASE_NAME, _PHASE, len(Phase))})


def read_reports(folder: Path, check: checked_json.Check) -> dict[str, Any]:
    """Returns file name -> report, in the order of categories.

    Raises:
        DatasetError: a file is none of them.
        ConfigurationError: a command names a folder of somebody's machine.
    """
    found = {}
    for path in sorted(folder.glob("*.json")):
        try:
            report = check(path.name, checked_json.read(path))
        except ValueError as error:
            raise DatasetError(
                "Not a report of what a policy draws.",
                got=f"{path.name}: {error}",
                allowed="what scripts/check_choices.py or scripts/check_motions.py has written",
                hint="run the script again with --out",
            ) from error
        check_command(report["command"])
        found[path.name] = report
    order = list(CATEGORIES)
    return dict(sorted(found.items(), key=lambda item: order.index(item[1]["category"])))


def choices_page(reports: Mapping[str, Any], present: Container[str]) -> str:
    """Returns the part of docs/results.md that tells what is tried after failures; ``present`` as `results_page`."""
    most = max((row["failed"] for report in reports.values() for row in report["after"]), default=0)
    later = range(1, most + 1)
    columns = ["category", "opened", "tried before a failure", *(f"new after {failed} failed" for failed in later)]
    rows = []
    for name, report in reports.items():
        after = {row["failed"]: row for row in report["after"]}
        episodes, opened = (sum(each[part] for each in report["episodes"].values()) for part in (0, 1))
        rows.append(
            [
                _told(name),
                f"{opened}/{episodes}",
                _shares(after[0]["draws"]) if 0 in after else "-",
                *(_new(after.get(failed)) for failed in later),
            ]
        )
    about = (
        "Each scene is played once under every hidden state (locked or not, either direction, each mode), and before "
        "each key frame the policy draws its next action sixteen times. *New*: draws that try something, and none of "
        "what has failed since anything has moved, of all draws that try something."
    )
    heading = "## What is tried after failures\n"
    return "\n".join((heading, about, "", markdown_table(columns, rows), "", *_sources(reports, present)))


def motions_page(reports: Mapping[str, Any], present: Container[str]) -> str:
    """Returns the part of docs/results.md that compares motions drawn with motions demonstrated."""
    columns = ("category", "phase", "rows", "demonstrated", "drawn", "nearest of the samples, off by")
    rows = [
        [_told(name), phase, str(row["rows"]), *(_spread(row[kind]) for kind in _DISTRIBUTIONS)]
        for name, report in reports.items()
        for phase, row in report["phases"].items()
    ]
    about = (
        "At rows of demonstrations the policy draws its next motion eight times: 10th, 50th and 90th percentile of "
        "what was demonstrated, of what is drawn, and of what the nearest sample is off by."
    )
    return "\n".join(
        (
            "## Motions drawn and demonstrated\n",
            about,
            "",
            markdown_table(columns, rows),
            "",
            *_sources(reports, present),
        )
    )


def _told(name: str) -> str:
    """A category may have several reports (``door_again.json``): what a row is called is the name of its file."""
    return name.removesuffix(".json").replace("_", " ")


def _tries(draws: Mapping[str, int]) -> dict[str, int]:
    return {what: count for what, count in draws.items() if what != NO_TRY}


def _shares(draws: Mapping[str, int]) -> str:
    tries = _tries(draws)
    total = max(1, sum(tries.values()))
    told = [f"{what} {100 * count / total:.0f} %" for what, count in tries.items() if count / total >= 0.005]
    return ", ".join(told) or "-"


def _new(row: Mapping[str, Any] | None) -> str:
    tries = 0 if row is None else sum(_tries(row["draws"]).values())
    return "-" if row is None or not tries else f"{100 * (1 - row['repeat_of_tries']):.1f} % of {tries:,}"


def _spread(motion: Mapping[str, Any]) -> str:
    length, angle = ("/".join(f"{value:g}" for value in motion[unit]) for unit in ("mm", "deg"))
    return f"{length} mm, {angle}°"


def _sources(reports: Mapping[str, Any], present: Container[str]) -> Iterator[str]:
    for name, report in reports.items():
        commit = "no commit" if report["commit"] is None else f"commit {report['commit'][:10]}"
        stale = "" if report["fingerprint"] in present else ", not the present code's"
        yield f"- `{report['command']}`; {commit}, fingerprint `{report['fingerprint']}`{stale} ({name})."
    yield ""
