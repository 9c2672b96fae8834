"""What decides an episode is in the fingerprint, and what does not is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from lerobot_adamanip.util.fingerprint import code_hash


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    for name, text in (("sim/drive.py", "step = 1\n"), ("sim/twin/server.py", "rate = 2\n"), ("env.py", "a = 3\n")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def hashed(sources: Path) -> str:
    return code_hash([sources / "sim", sources / "env.py"], but=[sources / "sim" / "twin"])


@pytest.mark.parametrize("name", ["sim/drive.py", "env.py", "sim/new.py"])
def test_code_that_decides_episodes_changes_the_hash(sources: Path, name: str) -> None:
    before = hashed(sources)
    (sources / name).write_text("other = 4\n")
    assert hashed(sources) != before


def test_folders_that_decide_none_and_comments_do_not(sources: Path) -> None:
    before = hashed(sources)
    (sources / "sim/twin/server.py").write_text("other = 4\n")
    (sources / "sim/twin/more.py").write_text("other = 4\n")
    (sources / "env.py").write_text('"""Says more."""\n\na = 3  # a remark\n')
    assert hashed(sources) == before
