"""`files`: a file is whole or absent, and what is synced is synced before what names it."""

from __future__ import annotations

import errno
import os
import re
import resource
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from lerobot_adamanip.util import files, jobs
from lerobot_adamanip.util.files import full_disk_error


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


def test_a_line_that_does_not_fit_is_an_error_and_damages_no_other_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "new" / "log"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (150, limits[1]))
        files.append_line(log, "a" * 100)
        with pytest.raises(OSError, match="File too large"):
            files.append_line(log, "b" * 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    files.append_line(log, "c")
    files.append_line(log, "d")
    assert log.read_text() == "a" * 100 + "\n" + "b" * 49 + "\nc\nd\n"


def test_threads_write_one_file_at_once(tmp_path: Path) -> None:
    contents = [bytes([number]) * 100_000 for number in range(64)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda content: files.write_atomically(tmp_path / "a", content), contents))
    assert (tmp_path / "a").read_bytes() in contents
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_processes_append_to_one_log(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as threads:  # each call opens the file anew, as a process does
        list(threads.map(lambda number: files.append_line(tmp_path / "log", f"{number:04d}" * 3000), range(64)))
    assert sorted((tmp_path / "log").read_text().split()) == [f"{number:04d}" * 3000 for number in range(64)]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_one_error_that_names_the_file(
    code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(OSError, match=r"a\.json") as caught:
        files.write_atomically(tmp_path / "a.json", b"content")
    assert re.search(rf"{tmp_path}/a.json: [\d.]+ MB free\n.*allowed:.*\n.*repeat", str(full_disk_error(caught.value)))
    assert "Traceback" not in jobs.error_text(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_without_a_file_names_the_place_with_the_least_space(tmp_path: Path) -> None:
    error = OSError(errno.ENOSPC, "No space left on device")
    assert "/proc/new: 0.0 MB free" in str(full_disk_error(error, [str(tmp_path / "new/er"), "/proc/new"]))
    assert full_disk_error(OSError(errno.EACCES, "Permission denied")) is None
    assert full_disk_error(ValueError()) is None
