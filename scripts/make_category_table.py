"""Writes docs/categories.md and docs/mechanism_rules.md: ``python scripts/make_category_table.py [--check]``."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from check_common import ROOT, document_command

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.experts import EXPERTS
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES, MECHANISM_RULES, RULES, make_mechanism, rules_of
from lerobot_adamanip.mechanisms.table import COMPOSED
from lerobot_adamanip.objects import ArticulatedObject, Joint

CATEGORIES_PAGE, RULES_PAGE = ROOT / "docs" / "categories.md", ROOT / "docs" / "mechanism_rules.md"
GENERATED = "Generated from the code by `python scripts/make_category_table.py`; a test compares the two."
INTRODUCTION = f"""# Categories

What the objects of each category hide, when they count as open, and how the experts open them. {GENERATED}

- Object counts are those of the paper's Table 1.
- Success thresholds are those of the paper's released code.
- Rules and the paper's wording: [mechanism rules](mechanism_rules.md).

![Four of the seen objects of each category](images/objects.png)

`adamanip objects --category all --objects 0:4 --columns 12 --size 124 --out docs/images/objects.png` draws this sheet.
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


def _mechanisms() -> list[str]:
    tables = [
        "## What opens each object?\n",
        "An episode succeeds when a joint of the last column is beyond its threshold. The hidden state is drawn for "
        "each episode. A span such as 12 ... 16 mm covers the seen objects.\n",
        "| category | seen objects | joints | hidden state | success |",
        "|---|---|---|---|---|",
    ]
    draws = [
        "\n## What is drawn for an episode?\n",
        f"These are the draws of the default rules, `{DEFAULT_MECHANISM_RULES}`. *Its range* is the range that was "
        "drawn.\n",
        "| category | draw | threshold |",
        "|---|---|---|",
    ]
    for name, category in CATEGORIES.items():
        objects = [make_object(object_id(name, number)) for number in range(category.seen)]
        mechanism = make_mechanism(objects[0])
        joints = "<br>".join(_joint([obj.joint(joint) for obj in objects]) for joint in mechanism.joints)
        rules = mechanism.rules()
        tables.append(f"| [`{name}`](#{name}) | {category.seen} | {joints} | {rules['hidden']} | {_success(objects)} |")
        draws.append(f"| `{name}` | {rules['draws']} | {rules['thresholds']} |")
    return [*tables, *draws]


def _rules() -> str:
    """Returns the page of rule sets: their differences, and the paper's sentences behind `paper`."""
    names = tuple(name for name in MECHANISM_RULES if name not in COMPOSED)
    lines = [
        "# Mechanism rules\n\nMechanism rules decide what is hidden in an episode, and what frees the part that opens. "
        f"{GENERATED}\n"
    ]
    lines += [
        "Choose them with `--env.mechanism_rules`; in `adamanip collect`, with `--mechanism-rules`.\n",
        "| rules | source |",
        "|---|---|",
    ]
    lines += [
        f"| `{name}`{' (default)' if name == DEFAULT_MECHANISM_RULES else ''} | {words} |"
        for name, words in MECHANISM_RULES.items()
    ]
    lines.append("\n## Where do they differ?\n")
    lines.append(
        "`paper`, `upstream` and `hard` exist for every category. The table has the categories in which they differ. "
        "In the others they are equal, and `collect` says so.\n"
    )
    lines += [f"| category | what | {' | '.join(f'`{name}`' for name in names)} |", "|---|---|" + "---|" * len(names)]
    for category in CATEGORIES:
        obj = make_object(object_id(category, 0))
        rules = [make_mechanism(obj, name).rules() for name in names]
        for key in rules[0]:
            said = [each[key] for each in rules]
            if len(set(said)) > 1:
                lines.append(f"| `{category}` | {key} | {' | '.join(said)} |")
    lines += [
        *_composed(),
        "\n## What does the paper say?\n",
        "`paper` follows these quotations. The last column is how they were understood.\n",
        "| category | quotation | so `paper` is |",
        "|---|---|---|",
    ]
    lines += [f"| `{name}` | {rules.paper} | {rules.reading} |" for name, rules in RULES.items()]
    return "\n".join(lines) + "\n"


def _composed() -> list[str]:
    """Returns the section of the rules that only some categories have."""
    lines = [
        "\n## Which rules do some categories have?\n",
        "`row` and `changing` are rules of the [tracks](tracks.md). They exist for categories with a part that is "
        "turned or pressed and another that opens. For any other category, the error lists those that have them.\n",
    ]
    for rules in COMPOSED:
        said = make_mechanism(make_object(object_id("door", 0)), rules).rules()
        lines.append(f"- `{rules}`, hidden: {said['hidden']}. Draws of a door: {said['draws']}.")
    lines += [
        "",
        f"| category | {' | '.join(f'`{rules}`' for rules in COMPOSED)} |",
        "|---" * (1 + len(COMPOSED)) + "|",
    ]
    for category in CATEGORIES:
        obj, own = make_object(object_id(category, 0)), [rules for rules in COMPOSED if rules in rules_of(category)]
        if own:
            said = {rules: make_mechanism(obj, rules).rules()["thresholds"] for rules in own}
            lines.append(f"| `{category}` | {' | '.join(said.get(rules, '-') for rules in COMPOSED)} |")
    return lines


def _experts() -> list[str]:
    lines = [
        "\n## What does the adaptive expert do?\n",
        "It opens by trial and error, without the hidden state.\n",
        "| category | `--env.type` | task | adaptive expert |",
        "|---|---|---|---|",
    ]
    for name, category in CATEGORIES.items():
        cells = (f'<a id="{name}"></a>`{name}`', f"`adamanip_{name}`", category.instruction, EXPERTS[name].sequence)
        lines.append(f"| {' | '.join(cells)} |")
    lines.append(
        "\n- If the rules fix the direction, the adaptive expert knows it and turns that way first.\n"
        "- The static expert sees the hidden state. It turns just far enough, at safes and lamps to the stop. It works "
        "the key (the part that frees the other) only if needed.\n"
        "- Both continue past success: doors to 42°, lids to 40 mm.\n\n"
        "## When does the adaptive expert try to open?\n"
    )
    lines.append(
        "How far a part must turn is hidden. `--expert-strategy` of `adamanip collect` chooses when the adaptive "
        "expert tries to open:\n\n"
        "- `paper` (default): as in the paper;\n"
        "- `upstream`: as in the paper's released code;\n"
        "- `to_stop`: at the felt stop, or at an angle that frees the part in every episode. It wastes the fewest "
        "tries.\n"
    )
    lines += ["| category | `paper` | `upstream` | `to_stop` |", "|---|---|---|---|"]
    for name, expert in EXPERTS.items():
        if (upstream := expert.others.get("upstream")) is not None:
            first = "after any turn" if name in ("window", "door") else "first, or after any turn"
            angle = math.degrees(upstream.not_before)
            lines.append(f"| `{name}` | {first} | not before {angle:.0f}° | at the felt stop |")
    return lines


def documents() -> dict[Path, str]:
    """Returns page -> text."""
    return {CATEGORIES_PAGE: "\n".join([INTRODUCTION, *_mechanisms(), *_experts()]) + "\n", RULES_PAGE: _rules()}


if __name__ == "__main__":
    sys.exit(document_command(__doc__, documents))
