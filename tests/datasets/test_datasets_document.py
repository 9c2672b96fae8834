"""The commands of docs/datasets.md do what the document says, one after another."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from doc_data import collect_fake_demos

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.datasets.conditions import episode_values
from lerobot_adamanip.datasets.dataset import Dataset, read_back

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "datasets.md"


def commands() -> list[list[str]]:
    """Every `adamanip` command of the document, in order."""
    found = re.findall(r"```bash\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    return [shlex.split(line) for block in found for line in block.splitlines() if line.startswith("adamanip ")]


def test_commands_run_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    collect_fake_demos(tmp_path / "outputs" / "demos")
    monkeypatch.chdir(tmp_path)
    ran = commands()
    assert {words[1] for words in ran} == {"filter", "split", "merge", "view"}
    for words in ran:
        assert main(words[1:]) == 0, words
    counts = {path.parent.parent.relative_to("outputs"): 0 for path in Path("outputs").rglob("meta/info.json")}
    for root in counts:
        read_back(Path("outputs") / root)
        counts[root] = len(Dataset(Path("outputs") / root))
    names = {str(root): count for root, count in counts.items()}
    assert names["again"] == names["demos"] == 6
    assert (names["parts/train"], names["parts/validation"]) == (5, 1)
    assert (names["by_object/train"], names["by_object/validation"]) == (3, 3)
    assert names["by_lock/true"] + names["by_lock/false"] == 6
    assert Path("outputs/episode_3.png").stat().st_size > 10_000


def test_names_in_the_table_are_known(finished: Path) -> None:
    known = set(episode_values(Dataset(finished)))
    table = [line.split("|")[1] for line in DOCUMENT.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    said = {name for cell in table for name in re.findall(r"`([\w.]+)`", cell)}
    assert len(said) > 15
    assert said - known == {"hidden.direction"}, "the fake environment hides less"
