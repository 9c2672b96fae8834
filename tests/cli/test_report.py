"""`adamanip report`: both forms say the same, several logs are compared, mistakes are one message."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure
from PIL import Image
from records import record

from lerobot_adamanip.cli import main as cli
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.report import compare
from lerobot_adamanip.evaluation.results import read_result


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


def report(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert cli.main(["report", *arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def by_name(groups: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {group["name"]: group for group in groups}


@pytest.mark.parametrize(
    ("options", "changes", "message"),
    [
        (["--title", "x|y"], {}, "title is 'x|y'"),
        ([], {"run_label": "x|y"}, "without |"),
        ([], {"seed": 5_000_000}, "split None"),
    ],
)
def test_values_that_make_no_result_are_one_message(
    options: list[str], changes: dict[str, Any], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records = [record(seed=1, run_id="a" * 12), record(**{"seed": 2, "run_id": "b" * 12, **changes})]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(one.to_json()) + "\n" for one in records))
    command = ["report", str(tmp_path / "log.jsonl"), "--out", str(tmp_path / "r.json"), "--command", "x", *options]
    assert cli.main(command) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "r.json").exists()


def test_json_is_one_object_with_counts_that_add_up(logs: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    said = report(capsys, *logs)
    assert set(said) == {"evaluations", "differences", "extra_tries", "warnings", "out"}
    first, second = said["evaluations"]
    assert (first["label"], second["label"]) == ("adaptive", "static")
    groups = by_name(first["groups"])
    assert groups["safe: locked"]["success"]["count"] == 9
    assert groups["safe: locked"]["success"]["episodes"] == groups["safe: unlocked"]["success"]["episodes"] == 10
    assert groups["all"]["success"]["episodes"] == first["episodes"] == 20
    counts = [(each["n_success"], each["n_episodes"], each["pc_success"]) for each in (first, groups["safe: locked"])]
    assert counts == [(19, 20, 95.0), (9, 10, 90.0)]
    assert groups["safe: locked"]["pc_success_ci95"] == pytest.approx([59.58, 98.21], abs=0.05)
    gaps = by_name(said["differences"])
    assert gaps["safe: locked"]["difference"] == pytest.approx(0.8)
    assert gaps["safe: locked"]["low"] > 0
    assert gaps["safe: unlocked"]["difference"] == 0
    assert said["warnings"] == []
    (column,) = report(capsys, logs[0], "--episodes", "15")["evaluations"]  # a surplus of the last batch is left out
    assert column["episodes"] == 15


def test_fewer_episodes_than_asked_are_warned_of_and_a_log_counts_once(
    logs: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert report(capsys, logs[0], "--episodes", "20")["warnings"] == []
    (warning,) = report(capsys, logs[0], "--episodes", "100")["warnings"]
    assert "20 episodes of safe, not 100" in warning
    assert cli.main(["report", logs[0], logs[0]]) == 2
    assert "given twice" in capsys.readouterr().err


def test_a_report_replaces_no_log_and_no_evaluation(
    logs: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.json"
    path.write_bytes(Path(logs[0]).read_bytes())
    assert cli.main(["report", str(path), "--out", str(path), "--command", "lerobot-eval"]) == 2
    assert "This would replace an episode log." in capsys.readouterr().err
    assert path.read_bytes() == Path(logs[0]).read_bytes()
    text = path.read_text()
    path.write_text(text + text.replace('"run_id": "run"', '"run_id": "later"'))
    assert cli.main(["report", str(path), logs[1], "--label", "a", "a #1"]) == 2
    assert "Two evaluations have one name." in capsys.readouterr().err


def test_tables_show_the_same_numbers(logs: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", *logs, "--label", "with history", "[bold]static"]) == 0
    printed = capsys.readouterr().out
    for text in ("with history", "[bold]static", "19/20", "9/10", "1/10", "tried the locked door first", "safe_00"):
        assert text in printed
    assert re.search(r"\| wasted tries, safe: locked +\| -0.50 ", printed)
    assert "with history - [bold]static, safe: locked: +80.0 points" in printed


def test_a_log_of_two_evaluations_gives_two_columns_and_one_if_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "log.jsonl", 5)
    other = write_log(tmp_path / "other.jsonl", 9).read_text().replace('"run_id": "run"', '"run_id": "later"')
    path.write_text(path.read_text() + other.replace('"run_label": null', '"run_label": "act"'))
    columns = report(capsys, str(path))["evaluations"]
    counts = [(each["label"], by_name(each["groups"])["all"]["success"]["count"]) for each in columns]
    assert counts == [("log #1", 15), ("log #2 act", 19)]
    columns = report(capsys, str(path), "--pool")["evaluations"]  # of two labels, of two policies
    assert [(each["label"], each["episodes"]) for each in columns] == [("log #1", 20), ("log #2 act", 20)]
    path.write_text(path.read_text().replace('"run_label": "act"', '"run_label": null'))
    (column,) = report(capsys, str(path), "--pool")["evaluations"]
    assert (column["episodes"], column["repeats"]) == (20, 20)
    assert cli.main(["report", str(path), "--pool"]) == 0
    assert "20 repeated episodes" in capsys.readouterr().out


def test_scenes_are_told_and_never_mixed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path / "log.jsonl", 9)
    tested = path.read_text()
    other = tested.replace('"split": "test"', '"split": "validation"').replace('"seed": ', '"seed": 100')
    path.write_text(tested + other)
    for options in ([], ["--pool"]):
        said = report(capsys, str(path), *options)
        assert [(each["scenes"], each["episodes"]) for each in said["evaluations"]] == [
            ("test", 20),
            ("validation", 20),
        ]
        assert said["differences"] == []
        assert ["no test result" in warning and "log #2" in warning for warning in said["warnings"]].count(True) == 1
    assert cli.main(["report", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "Success on test and validation scenes" in printed
    assert "20 on test scenes" in printed
    assert "report --episodes N" in printed


def test_a_result_file_says_what_was_measured(
    logs: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, command = tmp_path / "results" / "safe.json", "lerobot-eval --env.type=adamanip_safe"
    assert cli.main(["report", *logs, "--out", str(path), "--command", command]) == 0
    assert f"written: {path}" in capsys.readouterr().out
    result = read_result(path)
    assert (result.command, result.seeds, result.scenes) == (command, (0, 19), "test")
    assert [(row.subject, row.metrics.success) for row in result.rows] == [
        ("adaptive", rate(19, 20)),
        ("static", rate(11, 20)),
    ]
    assert (result.rows[0].metrics.hidden or {})["locked"] == rate(9, 10)
    assert (result.simulation_version, result.versions) == (SIMULATION_VERSION, {"torch": "2.11.0"})
    for log in map(Path, logs):
        log.write_text(log.read_text().replace('"version": "0.3.0"', '"version": "0.1.7"'))
    assert cli.main(["report", *logs, "--out", str(path), "--command", command]) == 0
    assert read_result(path).version == "0.1.7", "that of the episodes, not of their report"


def test_rows_without_data_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "door.jsonl"
    path.write_text(json.dumps(record(object_id="door_001", try_sequence=(), success=False).to_json()) + "\n")
    assert cli.main(["report", str(path)]) == 0
    table = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(table) > 5
    assert not [line for line in table if set(line.split("|")[2].split()) <= {"-", "0/0"}]


def test_rules_that_change_nothing_are_told(logs: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    log = Path(logs[0])
    log.write_text(log.read_text().replace('"mechanism_preset": "paper"', '"mechanism_preset": "hard"'))
    assert cli.main(["report", str(log)]) == 0
    assert "The mechanism rules hard are the paper rules for safe." in capsys.readouterr().out


@pytest.mark.parametrize("name", ["max_key_frames", "max_failed_tries", "poses", "sensing", "hints"])
def test_other_limits_are_compared_with_a_warning(name: str) -> None:
    records = {label: [record(seed=1)] for label in ("one", "other")}
    assert not [each for each in compare(records).warnings() if "not to be compared" in each]
    object.__setattr__(records["other"][0], name, 3)
    (warning,) = [each for each in compare(records).warnings() if "not to be compared" in each]
    assert "(one " in warning
    assert "other 3)" in warning


def test_two_simulation_versions_are_compared_with_a_warning_and_give_no_result(
    logs: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other, path = Path(logs[1]), tmp_path / "r.json"
    other.write_text(
        other.read_text().replace(f'"simulation_version": {SIMULATION_VERSION}', '"simulation_version": 1')
    )
    assert cli.main(["report", *logs]) == 0
    assert "Warning: not to be compared: simulation versions differ" in capsys.readouterr().out
    assert cli.main(["report", *logs, "--out", str(path), "--command", "lerobot-eval"]) == 2
    assert "one simulation version" in capsys.readouterr().err
    assert not path.exists()


def test_the_picture_is_drawn(logs: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "new" / "curve.png"
    assert cli.main(["report", *logs, "--out", str(picture)]) == 0
    with Image.open(picture) as image:
        colors = image.convert("RGB").getcolors(1 << 24)
    assert colors is not None
    assert len(colors) > 20


def test_labels_are_no_markup_in_pictures(
    logs: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels, drawn = [r"lr $\eta$=1, $\5$", "_hidden"], list[str]()

    def save(figure: Figure, path: Path, **options: Any) -> None:
        original(figure, path, **options)
        legend = figure.axes[0].get_legend()
        assert legend is not None
        drawn.extend(text.get_text().replace(r"\$", "$").strip() for text in legend.texts)

    original = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", save)
    picture = str(tmp_path / "curve.png")
    assert cli.main(["report", *logs, "--label", *labels, "--out", picture]) == 0
    assert drawn == labels


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.jsonl"], "Cannot read the episode log"),
        ([], "No episode log"),
        (["LOG", "--label", "a", "b"], "Labels do not fit"),
        (["LOG", "--out", "curve.doc"], "Unknown kind of file"),
        (["LOG", "--episodes", "0"], "Nothing to count"),
        (["LOG", "--out", "result.json"], "A result needs its command"),
        (["LOG", "--out", "r.json", "--command", "lerobot-eval --x=/home/me/y"], "must run elsewhere"),
    ],
)
def test_mistakes_are_one_message(
    arguments: list[str], message: str, logs: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["report", *(logs[0] if word == "LOG" else word for word in arguments)]) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.out == ""


def test_equal_file_names_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        paths.append(str(write_log(tmp_path / name / "episodes.jsonl", 3)))
    assert [row["label"] for row in report(capsys, *paths)["evaluations"]] == paths
