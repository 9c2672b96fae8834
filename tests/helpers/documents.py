"""The code blocks of the documents, and the commands in them."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [page for folder in ("docs", "docs/upstream") for page in (ROOT / folder).glob("*.md")]
DOCUMENTS = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", *(page.relative_to(ROOT).as_posix() for page in PAGES))


class Block(NamedTuple):
    document: str
    number: int
    language: str
    mark: str
    code: str


def blocks(language: str) -> list[Block]:
    """Fenced blocks of a language; ``mark`` is what a comment `<!-- test: ... -->` right above says."""
    found = []
    for document in DOCUMENTS:
        text = (ROOT / document).read_text(encoding="utf-8")
        pattern = r"(?:<!-- (?:test: )?([^>]*) -->\n)?^```(\w+)\n(.*?)^```$"
        for number, match in enumerate(re.finditer(pattern, text, re.MULTILINE | re.DOTALL)):
            if match[2] == language:
                found.append(Block(document, number, language, match[1] or "", match[3]))
    return found


def commands(prefix: str | tuple[str, ...], *documents: str) -> list[Any]:
    """Command lines of the bash blocks that start with ``prefix``, as argument lists, shell variables put in.

    Of all documents, or of those named.
    """
    found = []
    for block in blocks("bash"):
        if documents and block.document not in documents:
            continue
        variables: dict[str, str] = {}
        for line in block.code.replace("\\\n", " ").splitlines():
            for name, value in variables.items():
                line = line.replace(f'"${name}"', shlex.quote(value))  # noqa: PLW2901
            words = shlex.split(line, comments=True)
            if len(words) == 1 and re.match(r"[A-Z_]+=", words[0]):
                name, _, value = words[0].partition("=")
                variables[name] = value
            elif words and words[0].startswith(prefix):
                found.append(pytest.param(words, id=f"{block.document}: {' '.join(words)[:70]}"))
    return found
