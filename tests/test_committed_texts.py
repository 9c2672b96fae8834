"""Committed results and documents name no folder of one machine, no secret, and no script or command that is gone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from lerobot_adamanip.cli.main import COMMANDS
from lerobot_adamanip.hub.private_data import find_secrets
from lerobot_adamanip.util.machine_paths import MACHINE_PATH

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("results", "docs", "examples", "hub_cards", ".github")
SUFFIXES = (".md", ".json", ".csv", ".toml", ".txt", ".py", ".yml")
FORMER = ("CHANGELOG.md", "docs/decisions/", "docs/research/")
"""Texts about the past, which may name what is gone."""
OTHERS = ("/lerobot/",)
"""Absolute paths in images of other projects."""
AT_A_COMMIT = re.compile(r"git checkout [0-9a-f]{8,40} && [^\"\n]*")
"""A command that runs in an older revision."""
SCRIPT = re.compile(r"(?<![\w/.-])(?:scripts|examples|docs/images)/[\w/]+\.(?:py|sh)\b")
COMMAND = re.compile(r"(?:^|[\"'`]|\$ |&& )adamanip ([a-z]\w*)", re.M)


def texts() -> Iterator[Path]:
    """Committed texts, as paths relative to the repository."""
    yield from (path.relative_to(ROOT) for path in ROOT.glob("*.md"))
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in SUFFIXES:
                yield path.relative_to(ROOT)


TEXTS = [pytest.param(path, id=path.as_posix()) for path in texts()]


def gone(text: str) -> set[str]:
    """Scripts and commands in a text that do not exist."""
    text = AT_A_COMMIT.sub("", text)
    scripts = {name for name in SCRIPT.findall(text) if not (ROOT / name).is_file()}
    return scripts | {f"adamanip {name}" for name in COMMAND.findall(text) if name not in COMMANDS}


@pytest.mark.parametrize("path", TEXTS)
def test_it_names_no_folder_of_one_machine_and_no_secret(path: Path) -> None:
    text = (ROOT / path).read_text(encoding="utf-8")
    paths = re.findall(rf"(?:{MACHINE_PATH})[^\s\"']*", text)
    assert [each for each in paths if not each.startswith(OTHERS)] == []
    assert list(find_secrets(text)) == []


@pytest.mark.parametrize("path", [each for each in TEXTS if not each.id.startswith(FORMER)])
def test_every_script_and_command_in_it_exists(path: Path) -> None:
    assert gone((ROOT / path).read_text(encoding="utf-8")) == set()


def test_what_is_gone_is_found() -> None:
    assert gone('"command": "python scripts/bench_against.py --parts x"') == {"scripts/bench_against.py"}
    assert gone("git checkout 0123456789 && python scripts/gone.py --x") == set()
    assert gone("`adamanip publish` and\nadamanip collect x, the adamanip package") == {"adamanip publish"}
