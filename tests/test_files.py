"""`files`: a file is whole or absent, and what is synced is synced before what names it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from lerobot_adamanip.util import files


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """What was synced, in order."""
    order: list[Path] = []
    real = os.fsync

    def note(descriptor: int) -> None:
        order.append(Path(os.readlink(f"/proc/self/fd/{descriptor}")))
        real(descriptor)

    monkeypatch.setattr(files.os, "fsync", note)
    return order


def test_a_file_is_synced_before_it_gets_its_name_and_the_name_after(tmp_path: Path, synced: list[Path]) -> None:
    files.write_atomically(tmp_path / "a", b"content")
    assert (tmp_path / "a").read_bytes() == b"content"
    temporary, folder = synced
    assert temporary.name.endswith(".tmp")
    assert folder == tmp_path


def test_dying_before_the_rename_leaves_no_file_and_spoils_no_older_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(*_: object) -> None:
        raise KeyboardInterrupt

    files.write_atomically(tmp_path / "old", b"before")
    monkeypatch.setattr(files.os, "replace", die)
    for name in ("old", "new"):
        with pytest.raises(KeyboardInterrupt):
            files.write_atomically(tmp_path / name, b"after")
    assert (tmp_path / "old").read_bytes() == b"before"
    assert not (tmp_path / "new").exists()
    monkeypatch.undo()
    files.remove_temporaries(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["old"]


def test_a_tree_is_synced_from_the_inside_out(tmp_path: Path, synced: list[Path]) -> None:
    inner = tmp_path / "tree" / "inner"
    inner.mkdir(parents=True)
    (inner / "file").write_text("x")
    (tmp_path / "tree" / "other").write_text("y")
    files.sync_tree(tmp_path / "tree")
    places = {path.relative_to(tmp_path).as_posix(): place for place, path in enumerate(synced)}
    assert set(places) == {"tree/inner/file", "tree/inner", "tree/other", "tree"}
    assert places["tree/inner/file"] < places["tree/inner"] < places["tree"]
    assert places["tree/other"] < places["tree"]


def test_a_move_is_durable(tmp_path: Path, synced: list[Path]) -> None:
    (tmp_path / "from" / "here").mkdir(parents=True)
    (tmp_path / "to").mkdir()
    files.move_durably(tmp_path / "from" / "here", tmp_path / "to" / "there")
    assert (tmp_path / "to" / "there").is_dir()
    assert synced == [tmp_path / "to", tmp_path / "from"]
