"""Reports from files alone: what there is, beside the paper's; what is missing or of other code is marked."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import SCALE, FakeRunner, benchmark, content, declared, run_all
from matplotlib.figure import Figure
from PIL import Image

from lerobot_adamanip.benchmark.declaration import Declaration
from lerobot_adamanip.benchmark.plan import cell_of, options_key
from lerobot_adamanip.benchmark.plots import plot_report
from lerobot_adamanip.benchmark.report import BenchmarkReport, make_report, within
from lerobot_adamanip.benchmark.report_text import benchmark_page, summary
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.metrics import Metrics, pool
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.results import ResultFile, parse_result, read_result, read_results, write_result
from lerobot_adamanip.evaluation.text_format import csv_table
from lerobot_adamanip.util.errors import DatasetError

EFFECTS = [{"title": "demonstrations", "method": "ours", "without": "ours_on_static"}]
BY_CATEGORY, DIFFERENCES = "By category: opened/within [%]", "Differences in the same scenes"


def wide(**changes: Any) -> Declaration:
    scale = {**content()["scales"][SCALE], "categories": ["bottle", "safe"], "seeds": [1, 2], **changes}
    return declared(scales={SCALE: scale}, effects=EFFECTS)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Result files of a benchmark of two categories and two seeds."""
    folder = tmp_path_factory.mktemp("report")
    run_all(benchmark(folder / "out", FakeRunner(folder), wide()))
    return folder / "out" / "cells"


@pytest.fixture
def cells(whole: Path, tmp_path: Path) -> Path:
    """A copy of them, and nothing else."""
    return Path(shutil.copytree(whole, tmp_path / "cells"))


def report_of(cells: Path, **changes: Any) -> BenchmarkReport:
    return make_report(read_results(cells).values(), wide(), SCALE, **changes)


def change(path: Path, *, run: dict[str, Any] | None = None, row: dict[str, Any] | None = None, **changes: Any) -> None:
    """Writes a result file again, with other values of the result, of its run and of its row."""
    result = read_result(path)
    assert result.run is not None
    rows = (dataclasses.replace(result.rows[0], **(row or {})),)
    write_result(
        path, dataclasses.replace(result, rows=rows, run=dataclasses.replace(result.run, **(run or {})), **changes)
    )


def table(page: str, heading: str) -> dict[str, dict[str, str]]:
    """First cell -> title -> cell, of the table under a heading."""
    body = page[page.index(f"## {heading}\n") :]
    lines = re.findall(r"^\|(.*)\|$", body[: body.find("\n## ", 5)], re.MULTILINE)
    titles, _, *rows = [[cell.strip() for cell in line.split("|")] for line in lines]
    return {row[0]: dict(zip(titles, row, strict=True)) for row in rows}


def means(page: str) -> dict[str, dict[str, str]]:
    return table(page, "Means over the categories")


def percent(share: float | None) -> str:
    return f"{100 * (share or 0.0):.1f}".removesuffix(".0")


def test_trainings_are_counted_together_and_categories_equally(cells: Path) -> None:
    report = report_of(cells)
    entry = report.entries["ours", "safe", "seen"]
    one, two = (read_result(cells / f"ours-safe-seen-{seed}.json").rows[0].metrics.success for seed in (1, 2))
    assert entry.metrics.success == rate(one.count + two.count, one.episodes + two.episodes)
    assert report.trainings("ours", "seen") == "2"
    (cells / "ours-safe-seen-2.json").unlink()
    report = report_of(cells)
    rates = [one.metrics.success for one in report.of("ours", "seen")]
    assert [one.episodes for one in rates] == [10, 5]
    mean = report.mean("ours", "seen")
    assert mean == pytest.approx(sum(one.rate or 0.0 for one in rates) / 2)
    assert (report.trainings("ours", "seen"), report.trainings("ours", "unseen")) == ("1 to 2", "2")
    assert means(benchmark_page(report))["Ours, seen"]["opened"] == f"{100 * (mean or 0.0):.1f} %"
    shown = ("opened", "within", "wasted tries", "repeated")
    assert "-" not in [means(benchmark_page(report))["Ours, seen"][title] for title in shown]
    (cells / "ours-safe-seen-1.json").unlink()
    assert report_of(cells).mean("ours", "seen") is None
    row = means(benchmark_page(report_of(cells)))["Ours, seen"]
    assert [row[title] for title in shown] == ["-"] * 4, "a mean of one category is none"


def test_the_summary_has_the_methods_with_all_categories(cells: Path) -> None:
    (cells / "untrained-safe-seen-1.json").unlink()
    report = report_of(cells)
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in summary(report, report.methods).splitlines()
    ]
    rows = {line[0]: line[1:] for line in lines}
    assert "Untrained" not in rows
    both = [[report.mean("ours", one, share) or 0.0 for share in (within,)] for one in ("seen", "unseen")]
    opened = [report.mean("ours", one) or 0.0 for one in ("seen", "unseen")]
    cells_of_ours = [f"{100 * one:.1f} %, {100 * other[0]:.1f} %" for one, other in zip(opened, both, strict=True)]
    assert rows["Ours"] == [*cells_of_ours, "2"]
    (cells / "ours-safe-unseen-2.json").unlink()
    (cells / "ours-bottle-unseen-2.json").unlink()
    assert "| 2, 1 |" in summary(report_of(cells), report.methods), (
        "each split of objects has its own number of trainings"
    )
    only = summary(report, {"ours"})
    assert [name for name in rows if f"| {name} |" in only] == ["method", "---", "Ours"]
    assert summary(make_report([], wide(), SCALE), {"ours"}) == ""


def test_numbers_stand_beside_the_papers_if_the_scale_says_so(cells: Path) -> None:
    report = make_report(read_results(cells).values(), wide(beside_paper=True), SCALE)
    page = benchmark_page(report)
    rows, entry = table(page, BY_CATEGORY), report.entries["ours", "bottle", "seen"]
    shares = [entry.metrics.success.rate, entry.metrics.within_best_tries and entry.metrics.within_best_tries.rate]
    assert rows["Ours, seen"]["bottle"] == f"{'/'.join(map(percent, shares))} ↓", "below 95 - 10"
    papers = {name: row for name, row in rows.items() if "the paper" in name}
    assert set(papers) == {"Ours, the paper, seen", "Sampling, the paper, seen"}, "one row is no method of the paper"
    assert (papers["Ours, the paper, seen"]["safe"], papers["Sampling, the paper, seen"]["safe"]) == ("61±33", "16±12")
    marked = [(name, category) for name, row in rows.items() for category, cell in row.items() if "↓" in cell]
    assert marked == [("Ours, seen", "bottle")], "the paper has no unseen objects, and no other seen one is below it"
    assert [means(page)[f"{name}, seen"]["the paper, seen"] for name in ("Ours", "Untrained")] == ["78.2 %", "16.5 %"]
    alone = make_report(read_results(cells).values(), wide(note="One object."), SCALE)
    assert "One object. " in benchmark_page(alone)
    assert "the paper" not in benchmark_page(alone)


def test_methods_are_compared_in_the_scenes_and_trainings_that_both_have(cells: Path) -> None:
    report, both = report_of(cells), ("ours", "ours_on_static")
    gap = report.paired(both, ("bottle", "safe"), "seen", "1")
    assert gap is not None
    first, second = (pool(one.metrics for one in report.of(name, "seen")).success for name in both)
    assert gap.difference == pytest.approx((first.count - second.count) / first.episodes)
    page = benchmark_page(report)
    (line,) = re.findall(r"^\| demonstrations \| all, seen \| ([^|]*) \|", page, re.MULTILINE)
    assert line.startswith(f"{100 * gap.difference:+z.0f} [")
    assert len(line.partition("] (")[2].split(", ")) == 2, "one number a training"
    assert "demonstrations" in table(page, DIFFERENCES)
    assert "Ours less Ours on static" not in page, "a declared comparison is not repeated"
    path = cells / "ours-safe-seen-1.json"
    (cells / "ours-safe-seen-2.json").unlink()
    gap = report_of(cells).paired(both, ("bottle", "safe"), "seen", "1")
    assert gap is not None
    assert tuple(gap.by_training) == (1,)
    result = read_result(path)
    for changes in ({"seeds": (0, 4)}, {"simulation_version": 1}, {"command": f"{result.command} --env.poses=fixed"}):
        write_result(path, dataclasses.replace(result, **changes))  # type: ignore[arg-type]
        assert report_of(cells).paired(both, ("bottle", "safe"), "seen", "1") is None
    path.unlink()
    rows = table(benchmark_page(report_of(cells)), DIFFERENCES)
    assert {row["categories, objects"] for row in rows.values()} <= {"bottle, seen", "all, unseen"}
    for each in cells.iterdir():
        change(each, row={"scene_outcomes": ""})
    assert DIFFERENCES not in benchmark_page(report_of(cells))


def test_a_method_without_training_is_compared_with_each_training(cells: Path) -> None:
    for path in cells.glob("*-*-seen-*.json"):
        opened = 5 if path.stem.startswith("untrained") else 4 if path.stem.endswith("-1") else 1
        outcomes = "2" * opened + "0" * (5 - opened)
        metrics = Metrics(rate(opened, 5), rate(opened, 5))
        change(path, row={"scene_outcomes": outcomes, "scene_tries": "", "metrics": metrics})
    gap = report_of(cells).paired(("ours", "untrained"), ("bottle", "safe"), "seen", "1")
    assert gap is not None
    assert gap.by_training == pytest.approx({1: -0.2, 2: -0.8})
    assert gap.difference == pytest.approx(-0.5), "the difference of the means: 50 % less 100 %"
    other = report_of(cells).paired(("untrained", "untrained"), ("bottle", "safe"), "seen", "1")
    assert other is not None
    assert tuple(other.by_training) == (1,), "one result is not several trainings"


def test_episodes_that_play_one_scene_are_one_scene_of_a_difference(cells: Path) -> None:
    both = (("ours", "ours_on_static"), ("bottle", "safe"), "seen", "1")
    once = report_of(cells).paired(*both)
    for path in cells.glob("*-seen-*.json"):
        result = read_result(path)
        metrics, row = pool([result.rows[0].metrics] * 3), result.rows[0]
        outcomes = "".join(3 * digit for digit in row.scene_outcomes)
        changes = {"scene_outcomes": outcomes, "scene_tries": "", "metrics": metrics}
        change(path, row=changes, command=f"{result.command} --env.repeats=3")
    assert report_of(cells).paired(*both) == once


def test_a_scene_that_is_played_again_has_a_column_for_each_time(cells: Path) -> None:
    heading = "Each time that a scene is played"
    assert heading not in benchmark_page(report_of(cells))
    for path in cells.glob("ours-*-seen-*.json"):
        metrics = Metrics(rate(5, 6), rate(4, 6))
        row = {"scene_outcomes": "212" + "202", "scene_tries": "190" + "120", "metrics": metrics}
        change(path, row=row, command=f"{read_result(path).command} --env.repeats=3")
    shown = {
        title.partition(":")[0]: cell
        for title, cell in table(benchmark_page(report_of(cells)), heading)["Ours, seen"].items()
    }
    assert (shown["time 1"], shown["time 2"], shown["time 3"]) == ("100.0 %, 1.00", "50.0 %, 9.00", "100.0 %, 0.00")


def test_the_curve_over_failed_tries_rises_to_the_success(cells: Path) -> None:
    report = report_of(cells)
    shares = report.opened_with("ours", "seen")
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(report.mean("ours", "seen"))
    entry = report.entries["ours", "safe", "seen"]
    row = dataclasses.replace(entry.results[0].rows[0], scene_outcomes="20121", scene_tries="09230")
    entry = dataclasses.replace(entry, results=(dataclasses.replace(entry.results[0], rows=(row,)),))
    alone = dataclasses.replace(report, entries={("ours", "safe", "seen"): entry})
    assert alone.opened_with("ours", "seen") == [], "not of all categories"
    alone = dataclasses.replace(alone, categories=("safe",))
    assert alone.opened_with("ours", "seen")[:5] == pytest.approx([0.4, 0.4, 0.6, 0.8, 0.8])


def test_the_csv_has_every_number_with_its_metrics(cells: Path) -> None:
    report = report_of(cells)
    lines = list(csv.DictReader(csv_table(list(report.csv_lines())).splitlines()))
    assert len(lines) == len(report.entries)
    places = ("subject", "category", "objects")
    (line,) = (each for each in lines if [each[name] for name in places] == ["ours", "safe", "seen"])
    metrics = report.entries["ours", "safe", "seen"].metrics
    assert (int(line["successes"]), int(line["episodes"])) == (metrics.success.count, 10)
    assert (line["trainings"], line["simulation_version"]) == ("2", str(SIMULATION_VERSION))
    assert re.search(r"\blocked \d/\d.*unlocked \d/\d", line["hidden"])
    assert "knob_range" not in line["hidden"], "halves of a range are one evaluation's own"
    counts = [metrics.opened_within(k).count for k in range(46)]
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, metrics.success.count)
    assert [int(line[f"within_{k}_key_frames"]) for k in (10, 15, 25)] == [counts[k] for k in (10, 15, 25)]
    for path in cells.glob("ours-safe-seen-*"):
        change(path, command=f"{read_result(path).command} --env.control=dense")
    lines = list(csv.DictReader(csv_table(list(report_of(cells).csv_lines())).splitlines()))
    assert {each["within_25_key_frames"] == "" for each in lines} == {True, False}, "steps are no key frames"


def test_what_is_missing_is_said_and_never_guessed(cells: Path, tmp_path: Path) -> None:
    for path in {*cells.glob("ours_on_static-*"), *cells.glob("*-bottle-*")}:
        path.unlink()
    report = report_of(cells, unavailable={"ours_on_static": "no policy 'luck' is installed"})
    page = benchmark_page(report)
    assert "bottle" not in table(page, BY_CATEGORY)["Ours, seen"]
    assert "Ours on static, seen" not in table(page, BY_CATEGORY)
    assert "Declared and not run: 14 cells; rows without a result are left out. No result of: Ours on static.\n" in page
    assert "- Ours on static cannot be run here: no policy 'luck' is installed" in page
    success, *_ = plot_report(report, tmp_path)
    with Image.open(success) as image:
        assert image.width < 1200
    empty = make_report([], wide(), SCALE)
    assert "0 results." in benchmark_page(empty)
    assert "%]" not in benchmark_page(empty)
    assert plot_report(empty, tmp_path) == []


def test_other_versions_and_other_options_are_marked(cells: Path) -> None:
    path = cells / "ours-safe-seen-1.json"
    original = path.read_text()

    def marks(*, stale: bool = False, **changes: Any) -> tuple[str, str, str]:
        path.write_text(original)
        change(path, **changes)
        page = benchmark_page(report_of(cells, stale={cell_of(read_result(path))} if stale else ()))
        return table(page, BY_CATEGORY)["Ours, seen"]["safe"][-1], means(page)["Ours, seen"]["opened"][-1], page

    assert marks()[1] == "%"
    assert "Mind" not in marks()[2]
    assert marks(run={"data_version": 1})[:2] == ("†", "†")
    *both, page = marks(simulation_version=1)
    assert both == ["†", "†"]
    assert "of an earlier simulation or data version" in page
    assert "Note: several simulation versions" in page
    newer = {"python": "3.12.0", "torch": "2.10.0"}
    assert "Note: measured with different versions installed: torch 2.10.0 and 2.11.0." in marks(versions=newer)[2]
    assert marks(stale=True)[:2] == ("†", "†")
    assert marks(run={"options": "e" * 16})[:2] == ("‡", "‡")
    report = report_of(cells)
    (row,) = (line for line in summary(report, {"ours"}).splitlines() if line.startswith("| Ours |"))
    assert [cell.strip()[-1] for cell in row.strip("|").split("|")[1:3]] == ["‡", "%"]
    assert "‡: of other options than declared now" in summary(report, {"ours"})
    rows = re.findall(
        r"^\| (demonstrations|Ours less Untrained) \| all, (\w+) \| ([^|]*) \|", benchmark_page(report), re.MULTILINE
    )
    assert {(title, objects): gap[-1] == "‡" for title, objects, gap in rows} == {
        (title, objects): objects == "seen"
        for title in ("demonstrations", "Ours less Untrained")
        for objects in ("seen", "unseen")
    }, "a difference of a marked number is marked"


def test_other_options_of_a_seed_that_is_not_declared_are_marked(cells: Path) -> None:
    path = cells / "ours-safe-seen-3.json"
    for options, mark in (("", "%"), ("e" * 16, "‡")):
        shutil.copyfile(cells / "ours-safe-seen-2.json", path)
        cell = dataclasses.replace(cell_of(read_result(path)), seed=3)
        change(path, run={"seed": 3, "options": options or options_key(cell, wide(), SCALE)})
        page = benchmark_page(report_of(cells))
        assert means(page)["Ours, seen"]["trainings"] == "2 to 3"
        assert means(page)["Ours, seen"]["opened"][-1] == mark


def test_a_method_that_is_declared_no_more_keeps_its_row(cells: Path) -> None:
    path = cells / "theirs-safe-seen-1.json"
    shutil.copyfile(cells / "ours-safe-seen-1.json", path)
    change(path, run={"method": "theirs", "package": "their-lab"}, row={"subject": "Theirs"})
    theirs = table(benchmark_page(report_of(cells)), BY_CATEGORY)["Theirs (their-lab), seen"]
    assert theirs["bottle"] == "-"
    assert theirs["safe"].startswith(percent(read_result(path).rows[0].metrics.success.rate))


def test_methods_of_one_title_are_told_apart(cells: Path) -> None:
    path = cells / "former-safe-seen-1.json"
    shutil.copyfile(cells / "ours-safe-seen-1.json", path)
    change(path, run={"method": "former"})
    report = report_of(cells)
    assert len(set(report.titles.values())) == len(report.titles)
    assert report.titles["former"] == f"{wide().methods['ours'].title} (former)"


def test_a_result_of_no_benchmark_is_named(cells: Path) -> None:
    path = cells / "other.json"
    write_result(path, dataclasses.replace(read_result(cells / "ours-safe-seen-1.json"), run=None, title="Of a log"))
    with pytest.raises(DatasetError, match=r"(?s)no benchmark.*Of a log"):
        report_of(cells)


def test_costs_of_shared_steps_are_counted_once(cells: Path) -> None:
    # Demonstrations: two sets of two categories and seeds. Trainings: two methods of them. Tests: two splits
    # of the two trained methods, and of the untrained one with its one seed.
    page = benchmark_page(report_of(cells))
    counts = dict(re.findall(r"(\w+) [\d.]+ \w+ \((\d+) times\)", page))
    assert counts == {"collecting": "8", "training": "8", "evaluating": "20"}
    assert "on 2 cores, no GPU\n" in page
    runs = report_of(cells).runs_of("ours")
    assert len(runs) == 4, "of two categories and seeds; two splits share each"
    assert machine_text({"cores": 1, "gpu": True}) == "1 core, a GPU"


@pytest.fixture
def legends(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The legend of each picture that is saved."""
    drawn = list[list[str]]()

    def save(figure: Figure, path: Path, **options: Any) -> None:
        original(figure, path, **options)
        drawn.append([text.get_text().replace(r"\$", "$").strip() for text in figure.legends[0].texts])

    original = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", save)
    return drawn


def test_titles_of_methods_are_no_markup_in_pictures(cells: Path, tmp_path: Path, legends: list[list[str]]) -> None:
    report = report_of(cells)
    titles = {name: rf"_{name}, lr $\eta$=1, $\5$" for name in report.titles}
    plot_report(dataclasses.replace(report, titles=titles), tmp_path / "new")
    assert legends == [[titles[name] for name in report.methods]] * 2


def test_pictures_are_drawn_also_where_a_number_is_missing(cells: Path, tmp_path: Path) -> None:
    (cells / "untrained-bottle-seen-1.json").unlink()
    paths = plot_report(report_of(cells), tmp_path / "new")
    assert [path.name for path in paths] == ["success.png", "tries.png"]
    for path in paths:
        with Image.open(path) as image:
            colors = image.convert("RGB").getcolors(1 << 24)
        assert colors is not None
        assert len(colors) > 20


def test_each_of_many_methods_is_drawn(cells: Path, tmp_path: Path, legends: list[list[str]]) -> None:
    report = report_of(cells)
    names = [f"method_{number}" for number in range(25)]
    entries = {(name, "safe", "seen"): report.entries["ours", "safe", "seen"] for name in names}
    many = dataclasses.replace(
        report, titles=dict(zip(names, names, strict=True)), paper=dict.fromkeys(names, ""), entries=entries
    )
    assert plot_report(many, tmp_path)[0].name == "success.png"
    assert legends[0] == names


# Files ------------------------------------------------------------------------------------------------------------


def spoiled(result: ResultFile, path: str, value: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(json.dumps(result.to_json()))
    *folders, name = path.split("/")
    inner: Any = found
    for folder in folders:
        inner = inner[int(folder) if folder.isdecimal() else folder]
    inner[name] = value
    return found


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("schema", 2), ("host", "machine"), ("rows/0/category", "teapot"), ("run/seed", -1), ("rows/0/successes", 900),
        ("rows/0/key_frames", {"3": 1000}), ("rows/0/hidden", {"locked": [5, 3, 1]}), ("simulation_version", "new"),
        ("run/steps", {}), ("run/steps/train/command", "lerobot-train --x=/home/me/y"),
        ("run/costs/train/machine", {"name": "x"}), ("rows/0/subject", "a | b"), ("commit", "main"),
        ("run/package", "x y"), ("rows", []), ("kind", "guess"), ("seeds", [1]), ("scenes", "holdout"),
        ("seconds", -1), ("command", "a\nb"), ("command", "lerobot-eval --x=/home/me/model"),
        ("rows/0/within_best_tries", [5, 6]), ("rows/0/scene_outcomes", "22122"), ("rows/0/scene_outcomes", "000"),
        ("rows/0/scene_tries", "00"),
    ],
    ids=str,
)  # fmt: skip
def test_a_file_that_cannot_be_is_refused(whole: Path, tmp_path: Path, path: str, value: Any) -> None:
    result = read_result(whole / "ours-safe-seen-1.json")
    write_result(tmp_path / "again.json", result)
    assert read_result(tmp_path / "again.json") == result
    content = spoiled(result, path, value)
    with pytest.raises(ValueError):  # noqa: PT011  (each has its own text)
        parse_result(content)
    (tmp_path / "cell.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="Not a result file"):
        read_result(tmp_path / "cell.json")
