"""Writes docs/categories.md from the constants of the code: ``python scripts/make_category_table.py [--check]``."""

from __future__ import annotations

import math
import sys

from check_common import ROOT, document_command

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.experts import EXPERTS
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES, MECHANISM_RULES, RULES, make_mechanism
from lerobot_adamanip.objects import ArticulatedObject, Joint

PAGE = ROOT / "docs" / "categories.md"
INTRODUCTION = """# Categories

Generated from the code by `python scripts/make_category_table.py`; a test compares the two. Counts of objects are the
paper's (its Table 1); thresholds are those of its released code, at evaluation. What else differs from either stands in
[differences](differences.md).

A mechanism has three presets, `--env.mechanism_rules=` (in `adamanip collect`: `--mechanism-rules`):

| preset | |
|---|---|
"""


def _introduction() -> str:
    default = {DEFAULT_MECHANISM_RULES: " (default)"}
    rows = [f"| `{name}`{default.get(name, '')} | {words} |\n" for name, words in MECHANISM_RULES.items()]
    return INTRODUCTION + "".join(rows)


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


def _mechanisms() -> list[str]:
    lines = ["## Mechanisms\n", f"Under `{DEFAULT_MECHANISM_RULES}`:\n"]
    lines.append("| category | objects | joints | hidden state | drawn per episode | thresholds | success |")
    lines.append("|---|---|---|---|---|---|---|")
    for name, category in CATEGORIES.items():
        objects = [make_object(object_id(name, number)) for number in range(category.seen)]
        mechanism = make_mechanism(objects[0])
        joints = "<br>".join(_joint([obj.joint(joint) for obj in objects]) for joint in mechanism.joints)
        rules = mechanism.rules()
        cells = (f"[`{name}`](#{name})", str(category.seen), joints, rules["hidden"], rules["draws"])
        lines.append(f"| {' | '.join(cells)} | {rules['thresholds']} | {_success(objects)} |")
    return lines


def _presets() -> list[str]:
    """Where presets differ, and the sentences of the paper that `paper` follows."""
    names = tuple(MECHANISM_RULES)
    lines = ["\n## Where the presets differ\n", f"| category | what | {' | '.join(f'`{name}`' for name in names)} |"]
    lines.append("|---|---|" + "---|" * len(names))
    for category in CATEGORIES:
        obj = make_object(object_id(category, 0))
        rules = [make_mechanism(obj, name).rules() for name in names]
        for key in rules[0]:
            said = [each[key] for each in rules]
            if len(set(said)) > 1:
                lines.append(f"| `{category}` | {key} | {' | '.join(said)} |")
    lines += ["\n## What the paper says\n", "| category | quotation | so `paper` is |", "|---|---|---|"]
    return lines + [f"| `{name}` | {rules.paper} | {rules.reading} |" for name, rules in RULES.items()]


def _experts() -> list[str]:
    lines = ["\n## Experts\n", "| category | `--env.type` | task | adaptive expert |", "|---|---|---|---|"]
    for name, category in CATEGORIES.items():
        cells = (f'<a id="{name}"></a>`{name}`', f"`adamanip_{name}`", category.instruction, EXPERTS[name].sequence)
        lines.append(f"| {' | '.join(cells)} |")
    lines.append(
        "\nWhere the preset fixes the direction, the adaptive expert knows it, as a policy does after the first "
        "demonstration, and turns that way first. The static expert sees the hidden state and goes straight there: the "
        "true direction just far enough, the right motion, the key only if locked. Both go on past success to their "
        "own end: doors to 42°, lids to 40 mm.\n"
    )
    lines.append(
        "Of what is turned and then opened, nobody sees how far is far enough. `--expert-strategy` (of `adamanip "
        "collect`) says when the adaptive expert tries to open it: as the paper has it, as upstream's code does, or "
        "where the part has come to a stop, which wastes the fewest tries:\n"
    )
    lines += ["| category | `paper` | `upstream` | `to_stop` |", "|---|---|---|---|"]
    for name, expert in EXPERTS.items():
        if (theirs := expert.others.get("upstream")) is not None:
            first = "after any turn" if name in ("window", "door") else "first, or after any turn"
            angle = math.degrees(theirs.not_before)
            lines.append(f"| `{name}` | {first} | not before {angle:.0f}° | at the felt stop |")
    return lines


def page() -> str:
    """Returns the whole page."""
    return "\n".join([_introduction(), *_mechanisms(), *_presets(), *_experts()]) + "\n"


def main() -> int:
    """Writes the page, or says that it is not what it would be."""
    return document_command(__doc__, lambda: {PAGE: page()})


if __name__ == "__main__":
    sys.exit(main())
