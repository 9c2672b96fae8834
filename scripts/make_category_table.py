"""Writes docs/categories.md from the constants of the code: ``python scripts/make_category_table.py [--check]``."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.experts import SEQUENCES
from lerobot_adamanip.experts.turn_to_open import TURN_TO_OPEN, upstream
from lerobot_adamanip.mechanisms import MECHANISM_PRESETS, make_mechanism
from lerobot_adamanip.objects import ArticulatedObject, Joint

PAGE = Path(__file__).resolve().parents[1] / "docs" / "categories.md"
INTRODUCTION = """# Categories

Generated from the code by `python scripts/make_category_table.py`; a test compares the two. Counts and mechanisms are
the paper's (its Table 1, section 3.2, and the appendix "Adaptive Manipulation Sequence"); thresholds are those of its
released code, at evaluation. Where that code deviates from the paper's text, the text is the default, and the code is
the preset `--env.mechanism_preset=upstream` (in `adamanip collect`: `--mechanism-preset` and `--expert-preset`).
"""


def _number(value: float, kind: str) -> str:
    return f"{math.degrees(value):.0f}°" if kind == "revolute" else f"{1000 * value:.0f} mm"


def _span(values: list[float], kind: str) -> str:
    low, high = _number(min(values), kind), _number(max(values), kind)
    return low if low == high else f"{low.removesuffix(' mm').removesuffix('°')} ... {high}"


def _joint(joints: list[Joint]) -> str:
    first = joints[0]
    both = "±" if first.limits[0] < 0 else "0 to "
    return f"`{first.name}` {first.kind} {both}{_span([joint.limits[1] for joint in joints], first.kind)}"


def _success(objects: list[ArticulatedObject]) -> str:
    goals = [make_mechanism(obj).goals for obj in objects]
    parts = []
    for name in goals[0]:
        kind = objects[0].joint(name).kind
        parts.append(f"`{name}` beyond {_span([each[name] for each in goals], kind)}")
    return " or ".join(parts)


def page() -> str:
    """Returns the whole page."""
    lines = [INTRODUCTION, "## Mechanisms\n"]
    lines.append("| category | objects | joints | hidden state | drawn per episode | thresholds | success |")
    lines.append("|---|---|---|---|---|---|---|")
    deviations = []
    for name, category in CATEGORIES.items():
        objects = [make_object(object_id(name, number)) for number in range(category.seen)]
        paper, other = (make_mechanism(objects[0], preset).rules() for preset in MECHANISM_PRESETS)
        joints = "<br>".join(
            _joint([obj.joint(joint) for obj in objects]) for joint in make_mechanism(objects[0]).joints
        )
        cells = (
            f"[`{name}`](#{name})",
            str(category.seen),
            joints,
            paper["hidden"],
            paper["draws"],
            paper["thresholds"],
        )
        lines.append(f"| {' | '.join(cells)} | {_success(objects)} |")
        deviations += [
            f"| `{name}` | {key} | {paper[key]} | {other[key]} |" for key in paper if paper[key] != other[key]
        ]
    lines += ["\n## Experts\n", "| category | `--env.type` | task | adaptive expert |", "|---|---|---|---|"]
    for name, category in CATEGORIES.items():
        lines.append(
            f'| <a id="{name}"></a>`{name}` | `adamanip_{name}` | {category.instruction} | {SEQUENCES[name]} |'
        )
    lines.append(
        "\nThe static expert sees the hidden state and goes straight there: the true direction just far enough, the "
        "right motion, the key only if locked.\n"
    )
    lines += ["## What upstream's code does instead\n", "| category | what | paper's text (default) | `upstream` |"]
    lines += ["|---|---|---|---|", *deviations]
    for name, style in TURN_TO_OPEN.items():
        theirs = upstream(name)
        first = "first" if style.p_open_first else "after any turn"
        lines.append(
            f"| `{name}` | expert's first try to open | {first} | not before {math.degrees(theirs.not_before):.0f}° |"
        )
    lines.append("| all | pose of object, arm and camera | randomised | fixed: `--env.poses=fixed` |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Writes the page, or with --check says whether it is up to date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 if the page is out of date")
    wanted = page()
    if parser.parse_args().check:
        return 0 if PAGE.exists() and PAGE.read_text(encoding="utf-8") == wanted else 1
    PAGE.write_text(wanted, encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
