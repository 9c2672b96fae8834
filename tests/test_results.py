"""Numbers in the documents: those of the result files, with the versions that they were measured with."""

from __future__ import annotations

import csv
import dataclasses
import re
import shutil
from pathlib import Path
from typing import Any

import make_results
import pytest
from benchmark_helpers import FakeRunner, benchmark, run_all
from records import record

from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.results import (
    ResultFile,
    ResultRow,
    make_result,
    read_result,
    rows_of_records,
    write_result,
)
from lerobot_adamanip.evaluation.text_format import csv_table
from lerobot_adamanip.util.errors import ConfigurationError

ROOT = Path(__file__).resolve().parents[1]


def row(subject: str, category: str, objects: str, *counts: int) -> ResultRow:
    return ResultRow(subject, "paper", category, objects, Metrics(success=rate(*counts)))


def result(**changes: Any) -> ResultFile:
    rows = [
        row("adaptive", "safe", "seen", 19, 20), row("static", "safe", "seen", 20, 20),
        row("adaptive", "lamp", "seen", 9, 10), row("adaptive", "lamp", "novel", 8, 10),
    ]  # fmt: skip
    one = make_result(
        rows,
        kind="expert",
        title="scripted experts",
        command="python scripts/check_experts.py --category all",
        seeds=[7_000_000, 7_000_030],
        scenes=None,
        seconds=600.0,
    )
    return dataclasses.replace(one, **changes)


def test_documents_are_what_the_script_writes() -> None:
    for path, text in make_results.documents(make_results.RESULTS).items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run python scripts/make_results.py"


def test_documents_say_which_versions_were_mixed_or_are_not_the_present_ones(tmp_path: Path) -> None:
    old = {"simulation_version": SIMULATION_VERSION - 1}
    for changes, line in (
        ([{}, {}], ""),
        ([old, old], "Measured with simulation version 2; the present one is 3."),
        ([{}, old], "Measured with simulation versions 2 and 3; the present one is 3."),
        (
            [{"versions": {"torch": version}} for version in ("2.10.0", "2.11.0")],
            "They were measured with different versions installed: torch 2.10.0 and 2.11.0.",
        ),
    ):
        for name, values in zip(("demo", "other"), changes, strict=True):
            write_result(tmp_path / f"{name}.json", result(**values))  # type: ignore[arg-type]
        documents = make_results.documents(tmp_path)
        page = documents[make_results.PAGE].splitlines()
        assert [each for each in page if each.startswith(("Measured", "They were"))] == [line][: len(line)]
        note = "Measured with simulation version" in documents[make_results.README]
        assert note == ("simulation" in line and changes[0] == old)


def test_a_table_says_what_it_was_measured_with_and_ends_with_means_over_categories_that_all_have() -> None:
    page = make_results.results_page({"experts.json": result()}, [])
    for text in (
        "`python scripts/check_experts.py --category all`",
        f"simulation version {SIMULATION_VERSION}",
        "seeds 7000000 to 7000030",
        "results/experts.json",
        "10 min",
        " cores, ",
        "version ",
    ):
        assert text in page
    lines = make_results.success_table(result()).splitlines()
    assert lines[0] == "| expert | category | seen objects | novel objects |"
    assert lines[2:] == [
        "| adaptive | safe | 19/20 | - |",
        "| adaptive | lamp | 9/10 | 8/10 |",
        "| adaptive | mean of 2 | 92.5 % | - |",
        "| static | safe | 20/20 | - |",
    ]


def test_rows_of_several_mechanism_rules_are_not_mixed() -> None:
    rows = (row("adaptive", "safe", "seen", 19, 20), row("adaptive", "safe", "seen", 3, 20))
    rows = (rows[0], dataclasses.replace(rows[1], mechanism_rules="hard"))
    lines = make_results.success_table(result(rows=rows)).splitlines()
    assert "| adaptive, rules paper | safe | 19/20 |" in lines
    assert "| adaptive, rules hard | safe | 3/20 |" in lines


def test_an_evaluation_is_a_row_in_the_readme_and_a_line_of_all_metrics() -> None:
    records = [record(seed=k, locked=k % 2 == 0, success=k % 4 != 0) for k in range(20)]
    rows = rows_of_records([*records, records[0]], "dp3_adaptive")
    measured = result(kind="policy", rows=tuple(rows), scenes="test")
    block = make_results.readme_block({"demo.json": measured, "other.json": result()}, [])
    assert "scripted experts (test scenes): 15/20: 75 % [53.1, 88.8]\n" in block
    assert "scenes of no split" not in block, "other files are on the page alone"
    (line,) = csv.DictReader(csv_table(list(make_results.csv_lines("p.json", measured))).splitlines())
    assert (line["subject"], line["successes"], line["low"], line["high"]) == ("dp3_adaptive", "15", "0.5313", "0.8881")
    assert line["hidden"] == "direction +1 15/20, locked 5/10, unlocked 10/10"
    assert (line["wasted_tries"], line["failures"]) == ("-0.50", "ajar 5")


def test_a_result_comes_back_as_it_was_and_holds_no_path_of_this_machine(tmp_path: Path) -> None:
    one = result()
    write_result(tmp_path / "results" / "one.json", one)
    assert read_result(tmp_path / "results" / "one.json") == one
    assert re.fullmatch(r"[0-9a-f]{40}", one.commit or "0" * 40)
    with pytest.raises(ConfigurationError, match="No closing quotation"):
        write_result(tmp_path / "quote.json", result(command="lerobot-eval --job_name=bob's"))
    assert not (tmp_path / "quote.json").exists()
    with pytest.raises(ConfigurationError, match="must run elsewhere"):
        make_result([], kind="policy", title="x", command=f"eval --path={tmp_path}/x", seeds=[1], scenes="test")


def test_a_document_has_one_block() -> None:
    start, end, with_block = make_results.START, make_results.END, make_results.with_block
    assert with_block(f"a\n{start}\nold\n{end}\nb\n", f"{start}\nnew\n{end}") == f"a\n{start}\nnew\n{end}\nb\n"
    for document in ("nothing", f"{start} no end", f"{start}{end}{start}{end}"):
        with pytest.raises(ValueError, match="exactly one block"):
            with_block(document, "x")


def test_results_of_a_benchmark_have_their_part_of_the_page(tmp_path: Path) -> None:
    assert "Benchmark" not in make_results.documents(tmp_path)[make_results.PAGE]
    run_all(benchmark(tmp_path / "out", FakeRunner(tmp_path / "fake")))
    shutil.copytree(tmp_path / "out" / "cells", tmp_path / "benchmark" / "cpu")
    page = make_results.documents(tmp_path)[make_results.PAGE]
    assert "\n## Benchmark, scale cpu\n" in page
    assert re.search(r"^\| Ours, seen \| [\d.]+/[\d.]+ \|", page, re.MULTILINE)
    assert "| method, objects | safe |\n" in page, "a category without a result is left out"
