"""docs/upstream/adamanip.md, in the form of LeRobot's benchmark pages: its sections are there, its numbers are ours."""

from __future__ import annotations

import re
from pathlib import Path

from lerobot_adamanip.benchmark.paper_rates import PAPER_CATEGORIES
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.rates import success_summary
from lerobot_adamanip.evaluation.results import read_result

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "upstream" / "adamanip.md").read_text(encoding="utf-8")
SECTIONS = (
    "Available tasks", "Installation", "Evaluation", "Policy inputs and outputs", "Recommended evaluation episodes",
    "Training", "Reproducing results",
)  # fmt: skip
"""Of LeRobot's guide "Writing a benchmark doc page" (docs/source/adding_benchmarks.mdx), under the title, the
description, links and a picture."""


def rows(section: str) -> dict[str, list[str]]:
    """First cell of each row of a section's tables -> the other cells."""
    text = re.split(r"^#+ ", PAGE, flags=re.MULTILINE)[1:]
    (found,) = (part for part in text if part.startswith(f"{section}\n"))
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in found.splitlines() if line[:3] == "| `"]
    return {row[0].strip("`"): row[1:] for row in cells}


def test_it_has_the_sections_that_lerobot_wants_in_their_order() -> None:
    headings = re.findall(r"^##+ (.*)$", PAGE, re.MULTILINE)
    assert tuple(headings) == SECTIONS
    before = PAGE.partition("\n## ")[0]
    assert len([part for part in before.split("\n\n") if part[0] not in "#-!"]) == 2, "one or two paragraphs"
    assert re.search(r"^- Paper: ", before, re.MULTILINE)
    assert "![" in before


def test_tasks_have_the_counts_of_the_categories() -> None:
    listed = rows("Available tasks")
    seen = {name: CATEGORIES[name].seen for name in PAPER_CATEGORIES}
    for name, count in seen.items():
        assert listed[f"adamanip_{name}"][-1] == str(count)
    assert listed["adamanip"][-1] == str(sum(seen.values()))


def test_results_are_those_of_the_result_file() -> None:
    shown, (commit,) = rows("Reproducing results"), re.findall(r"commit `(\w+)`", PAGE)
    for name in PAPER_CATEGORIES:
        for cell, objects in zip(shown[f"adamanip_{name}"], ("seen", "unseen", "novel"), strict=True):
            result = read_result(ROOT / "results" / "benchmark" / "test" / f"corrected-{name}-{objects}-1000.json")
            assert str(result.commit).startswith(commit)
            keys = success_summary(result.rows[0].metrics.success)
            low, high = keys["pc_success_ci95"]
            assert cell == f"{keys['n_success']}/{keys['n_episodes']} [{low:.1f}, {high:.1f}]"
