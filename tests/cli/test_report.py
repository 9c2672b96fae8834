"""`adamanip report`: both forms say the same, several logs are compared, mistakes are one message."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image
from records import record

from lerobot_adamanip.cli import main as cli


def write_log(path: Path, locked_successes: int, episodes: int = 20) -> Path:
    lines = []
    for seed in range(episodes):
        locked = seed % 2 == 0
        success = not locked or seed // 2 < locked_successes
        lines.append(
            record(
                seed=seed,
                object_id=f"safe_{seed % 4:03d}",
                success=success,
                key_frames=9 + 11 * locked,
                locked=locked,
                blocked_pulls=int(locked),
                key_moved=locked,
            ).to_json()
        )
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


@pytest.fixture
def logs(tmp_path: Path) -> tuple[str, str]:
    return str(write_log(tmp_path / "adaptive.jsonl", 9)), str(write_log(tmp_path / "static.jsonl", 1))


def test_json_is_one_object_with_counts_that_add_up(logs: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", *logs, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) == {"evaluations", "differences", "plot"}
    first, second = report["evaluations"]
    assert (first["label"], second["label"]) == ("adaptive", "static")
    assert first["locked"]["count"] == 9
    assert first["locked"]["episodes"] + first["unlocked"]["episodes"] == first["episodes"] == 20
    (difference,) = report["differences"]
    assert difference["locked"]["difference"] == pytest.approx(0.8)
    assert difference["locked"]["low"] > 0
    assert difference["unlocked"]["difference"] == 0


def test_tables_show_the_same_numbers(logs: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", *logs, "--label", "with history", "[bold]static"]) == 0
    printed = capsys.readouterr().out
    for text in ("with history", "[bold]static", "19/20", "9/10", "1/10", "tried the locked door first", "safe_00"):
        assert text in printed


def test_repeats_are_counted_once_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path / "log.jsonl", 5)
    path.write_text(path.read_text() * 2)
    assert cli.main(["report", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "15/20" in printed
    assert "20 repeated episodes" in printed


def test_the_picture_is_drawn(logs: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "new" / "curve.png"
    assert cli.main(["report", *logs, "--plot", str(picture)]) == 0
    with Image.open(picture) as image:
        colors = image.convert("RGB").getcolors(1 << 24)
    assert colors is not None
    assert len(colors) > 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.jsonl"], "Cannot read the episode log"),
        ([], "No episode log"),
        (["LOG", "--label", "a", "b"], "Labels do not fit"),
        (["LOG", "--plot", "curve.doc"], "Unknown kind of picture"),
    ],
)
def test_mistakes_are_one_message(
    arguments: list[str], message: str, logs: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["report", *(logs[0] if word == "LOG" else word for word in arguments)]) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert "Traceback" not in printed.err
    assert printed.out == ""


def test_equal_file_names_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        paths.append(str(write_log(tmp_path / name / "episodes.jsonl", 3)))
    assert cli.main(["report", *paths, "--json"]) == 0
    assert [row["label"] for row in json.loads(capsys.readouterr().out)["evaluations"]] == paths
