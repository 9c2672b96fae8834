"""Commands in hints run as they are printed: each command that a hint names parses with the real parser."""

from __future__ import annotations

import ast
import json
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from asset_folders import partnet_safe, safe_annotation

from lerobot_adamanip.assets import AssetSource, load_object
from lerobot_adamanip.cli.main import COMMANDS, parse_command
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError

ROOT = Path(__file__).resolve().parents[2]
COMMAND = re.compile(rf"\badamanip ({'|'.join(COMMANDS)})\b([^;`]*)")
END = re.compile(r", | or |: | - |\.$")
PROSE = {"joins", "repairs", "shows", "of", "for", "with"}
"""Words that make a command in a sentence a name: `adamanip merge joins several`."""
VALUES = {"points": "1024", "category": "safe", "number": "1"}
"""Values of names in f-strings; others are words."""


def hints(path: Path) -> Iterator[tuple[int, str]]:
    """Yields line and text of every ``hint=`` in a module. Values in f-strings become words."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.keyword) and node.arg == "hint":
            yield node.value.lineno, text_of(node.value)


def text_of(node: ast.expr) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(text_of(part) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return VALUES.get(node.value.id if isinstance(node.value, ast.Name) else "", "WORD")
    return ""


def commands(hint: str) -> Iterator[list[str]]:
    """Yields the words of each command in a hint."""
    for name, rest in COMMAND.findall(hint):
        words = shlex.split(re.sub(r" \.\.\.(?= |$)", "", END.split(rest)[0]))
        if (words and not PROSE & set(words)) or hint == f"adamanip {name}":
            yield [name, *words]


FOUND = [
    pytest.param(command, id=f"{path.relative_to(ROOT)}:{line} {' '.join(command)}")
    for folder in ("lerobot_adamanip", "envs", "policies", "scripts")
    for path in sorted((ROOT / folder).rglob("*.py"))
    for line, hint in hints(path)
    for command in commands(hint)
]


@pytest.mark.parametrize("command", FOUND)
def test_a_command_in_a_hint_parses(command: list[str]) -> None:
    name, *words = command
    parse_command(name, words)


def test_hints_are_found() -> None:
    assert len(FOUND) > 30
    assert list(commands("delete it and run `adamanip collect DIR`; adamanip merge joins several")) == [
        ["collect", "DIR"]
    ]


def unannotated(folder: Path) -> None:
    partnet_safe(folder)


def of_another_category(folder: Path) -> None:
    (partnet_safe(folder) / "adamanip.json").write_text(json.dumps({**safe_annotation(), "category": "door"}))


def with_one_joint_for_both(folder: Path) -> None:
    annotation = safe_annotation()
    joints = annotation["joints"]
    first, second = joints
    joints[first] = joints[second]
    (partnet_safe(folder) / "adamanip.json").write_text(json.dumps(annotation))


@pytest.mark.parametrize("make", [unannotated, of_another_category, with_one_joint_for_both])
def test_the_command_that_annotates_an_object_finds_it(make: Callable[[Path], None], tmp_path: Path) -> None:
    folder = tmp_path / "my assets" / "101564"
    folder.parent.mkdir()
    make(folder)
    with pytest.raises(ConfigurationError) as caught:
        load_object(folder, "safe")
    command = printed(caught.value)
    assert command._folders() == [folder]
    assert command.category == "safe"


def test_the_command_that_lists_problems_of_assets_finds_them(tmp_path: Path) -> None:
    folder = tmp_path / "my assets"
    folder.mkdir()
    partnet_safe(folder / "101564")
    with pytest.raises(ConfigurationError) as caught:
        AssetSource(folder).select("safe", "all")
    command = printed(caught.value)
    assert (Path(command.assets), command.category) == (folder, "safe")


def printed(error: AdaManipError) -> Any:
    """Returns the command in the last line of an error, as the parser reads it from a shell."""
    _, _, line = str(error).splitlines()[-1].partition("adamanip ")
    name, *words = shlex.split(line)
    return parse_command(name, words)
