"""Texts stay plain: words that do not come back, tables that fit their column, pages that can be read at once."""

from __future__ import annotations

import re
from pathlib import Path

from lerobot_adamanip.contract.categories import CATEGORIES

ROOT = Path(__file__).resolve().parents[1]
MAX_COLUMNS, MAX_README_WORDS, MAX_PAGE_WORDS = 6, 1200, 1500
APART = ("docs/research/", "docs/upstream/", "docs/cards/")
"""Records, and texts for others: as long as they are."""
NUMBERS = "docs/results.md"
"""Tables of numbers: as long as there are results, with a column for each category."""
BY_CATEGORY = (NUMBERS, "docs/research/paper_setting.md")
WORDS = {
    r"\bwhom\b|\bwhoever\b": "a noun",
    r"\bsign of life\b|\bBeat\b": "heartbeat",
    r"\b[Dd]eaths? in a row\b": "consecutive crashes",
    r"\bis blamed\b|\bto blame\b": "the cause of a crash",
    r"\b[Cc]rews?\b": "workers, executor",
    r"\b[Ii]n vain\b": "failed",
    r"\btold_clearly\b": "translate_hub_errors",
    r"\bwhat (?:came|comes|becomes|became) of\b": "result, outcome",
    r"\bnobody looks\b": "without an observation",
    r"\bhappened again\b": "matches the recording",
    r"\b_?counting_rows\b": "valid_rows",
    r"\bSessionBoard\b": "RobotRegistry",
    r"\bleave_out_what\w*|\b_?owed\b|\b_hold_if_forgotten\b": "a verb and what it does",
    r"\b(?:NOT_)?DECIDING\b": "MANIFEST_FIELDS, RUNTIME_FIELDS",
    r"\b(?:GAVE|GIVES|SCATTERED|SILENT|BESIDE_POSITION)\b": "a name with a unit or a bound",
    r"\b[Mm]ends?\b|\b[Mm]ended\b": "repair, patch",
}
"""What has been replaced -> what stands instead."""
ALLOWED = {
    "docs/results.md": ("tried in vain",),
    "lerobot_adamanip/cli/check.py": ("mended",),
    "lerobot_adamanip/datasets/repair.py": ("mended",),
    "lerobot_adamanip/evaluation/metrics.py": ("tried in vain",),
    "lerobot_adamanip/util/files.py": ("partly mended",),
}
"""File -> parts of lines with such a word in what is stored or printed as JSON."""


def texts() -> dict[str, str]:
    """Path -> content of code, scripts and documents, less records and numbers."""
    folders = ("lerobot_adamanip", "envs", "policies", "scripts", "examples", "docs", "hub_cards")
    found = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".md", ".sh")]
    named = {path.relative_to(ROOT).as_posix(): path for path in (*found, ROOT / "README.md", ROOT / "CONTRIBUTING.md")}
    return {name: path.read_text(encoding="utf-8") for name, path in named.items() if not name.startswith(APART)}


def pages() -> dict[str, str]:
    """Document -> its text without code, comments and front matter."""
    hidden = re.compile(r"\A---\n.*?^---$|^```.*?^```$|<!--.*?-->", re.MULTILINE | re.DOTALL)
    return {name: hidden.sub("", text) for name, text in texts().items() if name.endswith(".md")}


def test_replaced_words_stay_away() -> None:
    wrong = []
    for name, text in texts().items():
        for at, line in enumerate(text.splitlines(), 1):
            if not any(part in line for part in ALLOWED.get(name, ())):
                wrong += [f"{name}:{at}: {word} -> {better}" for word, better in WORDS.items() if re.search(word, line)]
    assert wrong == []


def test_tables_fit_the_column() -> None:
    wide = {}
    for name, text in pages().items():
        columns = [
            line.replace(r"\|", "").strip().strip("|").count("|") + 1 for line in re.findall(r"^\|.*$", text, re.M)
        ]
        if max(columns, default=0) > (1 + len(CATEGORIES) if name in BY_CATEGORY else MAX_COLUMNS):
            wide[name] = max(columns)
    assert wide == {}


def test_documents_are_short() -> None:
    long = {}
    for name, text in pages().items():
        if name == NUMBERS:
            continue
        words = len(re.findall(r"\w[^\s|]*", re.sub(r"\]\([^)]*\)", "]", text)))
        if words > (MAX_README_WORDS if name == "README.md" else MAX_PAGE_WORDS):
            long[name] = words
    assert long == {}
