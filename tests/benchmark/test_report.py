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
from PIL import Image

from lerobot_adamanip.benchmark.declaration import Declaration
from lerobot_adamanip.benchmark.report import BenchmarkReport, make_report
from lerobot_adamanip.benchmark.report_plots import plot_report
from lerobot_adamanip.benchmark.report_text import benchmark_page, means_beside_paper, summary
from lerobot_adamanip.benchmark.result import CellResult, StepDone, parse_cell, read_cell, read_cells, write_cell
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.metrics import pool
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.tables import csv_table
from lerobot_adamanip.util.errors import DatasetError

TRIALS = {
    "method": "ours", "numbers": [0, 1, 2], "none": "static", "categories": ["bottle"], "splits": ["seen"],
    "scales": [SCALE],
}  # fmt: skip
EFFECTS = [{"title": "demonstrations", "method": "ours", "without": "ours_on_static"}]


def wide() -> Declaration:
    scale = {**content()["scales"][SCALE], "categories": ["bottle", "safe"], "seeds": [1, 2]}
    return declared(scales={SCALE: scale}, trials=TRIALS, effects=EFFECTS)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Result files of a benchmark of two categories, two seeds and a curve over trials."""
    folder = tmp_path_factory.mktemp("report")
    run_all(benchmark(folder / "out", FakeRunner(folder), wide()))
    return folder / "out" / "cells"


@pytest.fixture
def cells(whole: Path, tmp_path: Path) -> Path:
    """A copy of them, and nothing else."""
    return Path(shutil.copytree(whole, tmp_path / "cells"))


def report_of(cells: Path, **changes: Any) -> BenchmarkReport:
    return make_report(read_cells(cells), wide(), SCALE, **changes)


def rows_of(page: str, heading: str) -> dict[tuple[str, ...], list[str]]:
    """First two cells -> the others, of the table under a heading."""
    body = page[page.index(f"## {heading}\n") :]
    lines = re.findall(r"^\|(.*)\|$", body[: body.find("\n## ", 5)], re.MULTILINE)
    rows = [[cell.strip() for cell in line.split("|")] for line in lines]
    return {tuple(row[:2]): row[2:] for row in rows}


def means_of(page: str) -> dict[str, list[str]]:
    return {name: [first, *others] for (name, first), others in rows_of(page, "Mean success").items()}


def by_category(page: str, heading: str = "Success by category [%]") -> dict[str, dict[str, str]]:
    """Method and objects -> category -> percent, of a table with a column for each category."""
    titles, *rows = [[*first, *others] for first, others in rows_of(page, heading).items()]
    return {row[0]: dict(zip(titles[1:], row[1:], strict=True)) for row in rows}


def test_trainings_are_counted_together(cells: Path) -> None:
    report = report_of(cells)
    entry = report.entry("ours", "safe", "seen")
    assert entry is not None
    one, two = (read_cell(cells / f"ours-safe-seen-{seed}.json").numbers.success for seed in (1, 2))
    assert entry.numbers.success == rate(one.count + two.count, one.episodes + two.episodes)
    assert entry.seeds == (1, 2)
    shares = [each.numbers.success.rate for name in ("bottle", "safe") if (each := report.entry("ours", name, "seen"))]
    mean = report.mean("ours", "seen")
    assert mean == pytest.approx(sum(share or 0.0 for share in shares) / 2)
    assert means_of(benchmark_page(report))["Ours"][0] == f"{100 * (mean or 0.0):.1f} %"


def test_the_summary_has_the_methods_with_all_categories(cells: Path) -> None:
    (cells / "untrained-safe-seen-1.json").unlink()
    report = report_of(cells)
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in summary(report).splitlines()]
    rows = {line[0]: line[1:] for line in lines}
    assert set(rows) >= {"Ours", "Ours on static"}
    assert "Untrained" not in rows
    within = report.mean("ours", "seen", lambda numbers: numbers.within_best_tries)
    other = report.mean("ours", "unseen", lambda numbers: numbers.within_best_tries)
    means = [(report.mean("ours", "seen"), within), (report.mean("ours", "unseen"), other)]
    assert rows["Ours"] == [*(f"{100 * (one or 0.0):.1f} %, {100 * (two or 0.0):.1f} %" for one, two in means), "2"]
    assert within is not None
    assert within <= (report.mean("ours", "seen") or 0.0)
    for path in cells.iterdir():
        path.unlink()
    assert summary(report_of(cells)) == ""


def test_the_table_stands_beside_the_papers(cells: Path) -> None:
    page = benchmark_page(report_of(cells))
    rows = by_category(page)
    found = report_of(cells).entry("ours", "bottle", "seen")
    assert found is not None
    assert rows["Ours, seen"]["bottle"] == f"{100 * (found.numbers.success.rate or 0.0):.0f} ↓", "below 95 - 10"
    assert rows["Ours, the paper, seen"] == {"bottle": "95 ± 10", "safe": "61 ± 33"}
    assert rows["Sampling, the paper, seen"]["safe"] == "16 ± 12"
    marked = [(name, category) for name, row in rows.items() for category, cell in row.items() if "↓" in cell]
    assert marked == [("Ours, seen", "bottle")], "the paper has no unseen objects, and no other seen one is below it"
    assert len([name for name in rows if "the paper" in name]) == 2, "one row is no method of the paper"
    assert [row[-1] for name, row in means_of(page).items() if name in ("Ours", "Untrained")] == ["16.5 %", "78.2 %"]


def test_means_stand_beside_the_papers_where_all_categories_have_results(cells: Path) -> None:
    ours = report_of(cells).mean("ours", "seen") or 0.0
    assert f" Ours {100 * ours:.1f} % (78.2)" in means_beside_paper(report_of(cells))
    assert "Ours on static" not in means_beside_paper(report_of(cells)), "the paper has no such method"
    for path in cells.glob("ours-safe-seen-*.json"):
        path.unlink()
    assert " Ours " not in means_beside_paper(report_of(cells))


def test_a_scale_can_stand_without_the_papers(cells: Path) -> None:
    scale = {**content()["scales"][SCALE], "note": "One object, learnt by heart.", "beside_paper": False}
    report = make_report(read_cells(cells), declared(scales={SCALE: scale}, trials=TRIALS), SCALE)
    page = benchmark_page(report)
    assert means_beside_paper(report) == ""
    assert "One object, learnt by heart. " in page
    assert not [name for name in by_category(page) if "the paper" in name]
    assert means_of(page)["method"][-1] == "trainings"


def test_a_mean_weights_categories_equally_and_drops_no_training(cells: Path) -> None:
    (cells / "ours-safe-seen-2.json").unlink()
    report = report_of(cells)
    found = [report.entry("ours", category, "seen") for category in ("bottle", "safe")]
    rates = [each.numbers.success.rate for each in found if each is not None]
    assert [each.numbers.success.episodes for each in found if each is not None] == [10, 5]
    assert report.mean("ours", "seen") == pytest.approx(sum(filter(None, rates)) / 2)
    assert (report.trainings("ours", "seen"), report.trainings("ours", "unseen")) == ("1 to 2", "2")
    (cells / "ours-safe-seen-1.json").unlink()
    assert report_of(cells).mean("ours", "seen") is None


def test_the_same_scenes_are_compared(cells: Path) -> None:
    report = report_of(cells)
    gap = report.paired(("ours", "ours_on_static"), ("bottle", "safe"), "seen", "1")
    assert gap is not None
    both = [report.numbers(name, ("bottle", "safe"), ("seen",)) for name in ("ours", "ours_on_static")]
    first, second = (pool(each).success for each in both)
    assert gap.difference == pytest.approx((first.count - second.count) / first.episodes)
    assert tuple(gap.by_training) == (1, 2)
    rows = rows_of(benchmark_page(report), "In the same scenes")
    assert rows["Ours on static", "all, seen"][0].startswith(f"{100 * gap.difference:+.0f} [")
    assert len(rows["Ours on static", "all, unseen"][1].split(", ")) == 2, "one number a training"


def test_effects_are_shown_over_the_categories_that_both_have(cells: Path) -> None:
    shown = rows_of(benchmark_page(report_of(cells)), "Effects of changes")["demonstrations", "all, seen"]
    assert shown == rows_of(benchmark_page(report_of(cells)), "In the same scenes")["Ours on static", "all, seen"]
    for seed in (1, 2):
        (cells / f"ours-safe-seen-{seed}.json").unlink()
    page = benchmark_page(report_of(cells))
    one = rows_of(page, "Effects of changes")["demonstrations", "bottle, seen"]
    assert one == rows_of(page, "In the same scenes")["Ours on static", "bottle, seen"]


def test_trainings_and_scenes_that_both_have_are_compared(cells: Path) -> None:
    (cells / "ours-safe-seen-2.json").unlink()
    gap = report_of(cells).paired(("ours", "ours_on_static"), ("bottle", "safe"), "seen", "1")
    assert gap is not None
    assert tuple(gap.by_training) == (1,)
    path = cells / "ours-safe-seen-1.json"
    result = read_cell(path)
    step = result.steps["evaluate"]
    poses = StepDone(key=step.key, command=f"{step.command} --env.poses=fixed")
    for changes in ({"scene_seeds": (0, 4)}, {"simulation_version": 1}, {"steps": {**result.steps, "evaluate": poses}}):
        write_cell(path, dataclasses.replace(result, **changes))
        assert report_of(cells).paired(("ours", "ours_on_static"), ("bottle", "safe"), "seen", "1") is None
    for each in cells.iterdir():
        write_cell(each, dataclasses.replace(read_cell(each), outcomes=""))
    assert "In the same scenes" not in benchmark_page(report_of(cells))


def test_the_curve_over_failed_tries_rises_to_the_success(cells: Path) -> None:
    report = report_of(cells)
    shares = report.opened_with("ours", "seen")
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(report.mean("ours", "seen"))
    (one,) = (each for each in report.results if each.cell.name == "ours-safe-seen-1")
    one = dataclasses.replace(one, outcomes="20121", failed_tries="09230")
    alone = dataclasses.replace(report, results=(one,))
    assert alone.opened_with("ours", "seen") == [], "not of all categories"
    alone = dataclasses.replace(alone, categories=("safe",))
    assert alone.opened_with("ours", "seen")[:5] == pytest.approx([0.4, 0.4, 0.6, 0.8, 0.8])


def test_curves_over_trials_and_key_frames(cells: Path) -> None:
    report = report_of(cells)
    page = benchmark_page(report)
    body = page[page.index("## Success against failed trials") : page.index("## Success within a number")]
    lines = [line.strip("| ").split(" | ") for line in body.splitlines() if line.startswith("| bottle")]
    assert [(line[2], line[-1]) for line in lines] == [("0", "87.1 %"), ("1", "93.6 %"), ("2", "75.7 %")]
    table = report.entry("ours", "bottle", "seen")
    one = report.entry("ours", "bottle", "seen", trials=1)
    assert table is not None
    assert one is not None
    assert one.numbers == table.numbers, "one trial is what the table has"
    within = [table.numbers.opened_within(k).count for k in range(46)]
    assert within == sorted(within)
    assert (within[0], within[-1]) == (0, table.numbers.success.count)
    assert lines[1][4].startswith(f"{within[15]}/")
    budgets = rows_of(page, "Success within a number of key frames")
    assert budgets["mean over the categories", "objects"] == ["10", "15", "25", "45"]


def test_the_csv_has_every_number_with_its_metrics(cells: Path) -> None:
    report = report_of(cells)
    lines = list(csv.DictReader(csv_table(report.csv_rows()).splitlines()))
    assert len(lines) == len(report.entries)
    places = ("subject", "category", "objects", "trials")
    (line,) = (each for each in lines if [each[name] for name in places] == ["ours", "safe", "seen", ""])
    found = report.entry("ours", "safe", "seen")
    assert found is not None
    assert (int(line["successes"]), int(line["episodes"])) == (found.numbers.success.count, 10)
    assert (line["trainings"], line["simulation_version"]) == ("2", str(SIMULATION_VERSION))
    assert re.search(r"\blocked \d/\d.*unlocked \d/\d", line["hidden"])
    assert "knob_range" not in line["hidden"], "halves of a range are one evaluation's own"
    page = benchmark_page(report)
    assert rows_of(page, "Tries")["Ours", "seen"]
    within = by_category(page, "Opened within the best strategy's tries, by category [%]")["Ours, seen"]["safe"]
    share = found.numbers.within_best_tries
    assert share is not None
    assert float(within) == pytest.approx(100 * (share.rate or 0.0), abs=0.05)


def test_a_missing_cell_is_marked_and_never_guessed(cells: Path) -> None:
    for name in ("ours_on_static-bottle-seen-1", "ours_on_static-bottle-seen-2", "ours-safe-seen-2"):
        (cells / f"{name}.json").unlink()
    report = report_of(cells)
    page = benchmark_page(report)
    assert by_category(page)["Ours on static, seen"]["bottle"] == "-"
    means = means_of(page)
    assert means["Ours"][means["method"].index("trainings")] == "1 to 2"
    assert means["Ours on static"][0] == "-", "a mean of one category is none"
    assert "Declared and not run: 3 cells; rows without a result are left out.\n" in page
    assert [cell.category for cell in report.missing] == ["bottle", "bottle", "safe"]


def test_a_method_without_a_result_has_a_line_and_no_row(cells: Path, tmp_path: Path) -> None:
    for path in {*cells.glob("ours_on_static-*"), *cells.glob("*-bottle-*")}:
        path.unlink()
    report = report_of(cells)
    page = benchmark_page(report)
    assert list(by_category(page)["Ours, seen"]) == ["safe"]
    assert "Ours on static, seen" not in by_category(page)
    assert "Declared and not run: 20 cells; rows without a result are left out. No result of: Ours on static.\n" in page
    assert report.categories_with_results == ("safe",)
    (success,) = plot_report(report, tmp_path)
    with Image.open(success) as image:
        assert image.width < 1200


def test_what_cannot_be_run_is_marked_with_its_reason(cells: Path) -> None:
    for path in cells.glob("untrained-*"):
        path.unlink()
    report = report_of(cells, unavailable={"untrained": "no policy 'luck' is installed"})
    page = benchmark_page(report)
    assert "Untrained, seen" not in by_category(page)
    assert "- Untrained cannot be run here: no policy 'luck' is installed" in page


def test_other_versions_and_other_options_are_marked(cells: Path) -> None:
    path = cells / "ours-safe-seen-1.json"
    result = read_cell(path)

    def marks(changed: CellResult, **given: Any) -> tuple[str, str]:
        write_cell(path, changed)
        page = benchmark_page(report_of(cells, **given))
        return by_category(page)["Ours, seen"]["safe"][-1], means_of(page)["Ours"][0][-1]

    assert marks(result) == ("0", "%")
    for name in ("simulation_version", "data_version"):
        assert marks(dataclasses.replace(result, **{name: 1})) == ("†", "†")
        assert "of an earlier simulation or data version" in benchmark_page(report_of(cells))
    marks(dataclasses.replace(result, simulation_version=1))
    assert "Mind: several simulation versions" in benchmark_page(report_of(cells))
    marks(dataclasses.replace(result, versions={**result.versions, "torch": "2.10.0"}))
    assert "Mind: measured with different versions installed: torch 2.10.0 and 2.11.0." in benchmark_page(
        report_of(cells)
    )
    assert marks(result)[0] == "0"
    assert "Mind" not in benchmark_page(report_of(cells))
    assert marks(result, stale={result.cell}) == ("†", "†")
    assert marks(dataclasses.replace(result, options="e" * 16)) == ("‡", "‡")


def test_a_method_that_is_declared_no_more_keeps_its_row(cells: Path) -> None:
    result = read_cell(cells / "ours-safe-seen-1.json")
    cell = dataclasses.replace(result.cell, method="theirs")
    write_cell(cells / f"{cell.name}.json", dataclasses.replace(result, cell=cell, title="Theirs", package="their-lab"))
    theirs = by_category(benchmark_page(report_of(cells)))["Theirs (their-lab), seen"]
    assert theirs["bottle"] == "-"
    assert float(theirs["safe"]) == pytest.approx(100 * (result.numbers.success.rate or 0.0), abs=0.05)


def test_costs_of_shared_steps_are_counted_once(cells: Path) -> None:
    # Demonstrations: two sets of two categories, and two trials. Trainings: two methods of two categories and seeds,
    # and two trials of two seeds. Tests: two objects of three methods, two categories, two seeds, and those two trials.
    page = benchmark_page(report_of(cells))
    counts = dict(re.findall(r"^- (\w+): .*, (\d+) times$", page, re.MULTILINE))
    assert counts == {"collecting": "5", "training": "10", "evaluating": "22"}
    assert "- on 2 cores, no GPU\n" in page
    assert machine_text({"cores": 1, "gpu": True}) == "1 core, a GPU"


def test_no_result_is_no_table(tmp_path: Path) -> None:
    report = make_report([], wide(), SCALE)
    assert "0 results." in benchmark_page(report)
    assert "%]" not in benchmark_page(report)
    assert plot_report(report, tmp_path) == []


def test_pictures_are_drawn_also_where_a_number_is_missing(cells: Path, tmp_path: Path) -> None:
    (cells / "untrained-bottle-seen-1.json").unlink()
    paths = plot_report(report_of(cells), tmp_path / "new")
    assert [path.name for path in paths] == ["success.png", "trials.png", "tries.png"]
    for path in paths:
        with Image.open(path) as image:
            colors = image.convert("RGB").getcolors(1 << 24)
        assert colors is not None
        assert len(colors) > 20


# Numbers and files ------------------------------------------------------------------------------------------------


def test_a_result_comes_back_as_it_was(cells: Path, tmp_path: Path) -> None:
    result = read_cell(cells / "ours-safe-seen-1.json")
    write_cell(tmp_path / "again.json", result)
    assert read_cell(tmp_path / "again.json") == result


def spoiled(result: CellResult, path: str, value: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(json.dumps(result.to_json()))
    *folders, name = path.split("/")
    inner = found
    for folder in folders:
        inner = inner[folder]
    inner[name] = value
    return found


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("schema", 2), ("host", "machine"), ("cell/category", "teapot"), ("cell/seed", -1), ("numbers/successes", 900),
        ("numbers/key_frames", {"3": 1000}), ("numbers/hidden", {"locked": [5, 3, 1]}), ("simulation_version", "new"),
        ("steps", {}), ("steps/train/command", "lerobot-train --x=/home/me/y"), ("costs/train/machine", {"name": "x"}),
        ("title", "a | b"), ("commit", "main"), ("package", "x y"),
    ],
    ids=str,
)  # fmt: skip
def test_a_file_that_cannot_be_is_refused(whole: Path, tmp_path: Path, path: str, value: Any) -> None:
    content = spoiled(read_cell(whole / "ours-safe-seen-1.json"), path, value)
    with pytest.raises(ValueError):  # noqa: PT011  (each has its own text)
        parse_cell(content)
    (tmp_path / "cell.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="Not a result of a benchmark"):
        read_cell(tmp_path / "cell.json")
