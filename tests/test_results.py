"""Numbers in the documents: those of the result files, with the versions that they were measured with."""

from __future__ import annotations

import csv
import dataclasses
import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import pytest
from benchmark_helpers import FakeRunner, benchmark, run_all
from records import record

from lerobot_adamanip.benchmark.result import write_cell
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.metric_values import Mean
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
from lerobot_adamanip.evaluation.results_page import (
    END,
    START,
    csv_rows,
    readme_block,
    results_page,
    success_table,
    with_block,
)
from lerobot_adamanip.evaluation.tables import csv_table
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

ROOT = Path(__file__).resolve().parents[1]


def script() -> Any:
    spec = importlib.util.spec_from_file_location("make_results", ROOT / "scripts" / "make_results.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def row(
    subject: str,
    category: str,
    objects: str,
    counts: tuple[int, int],
    key_frames: float | None = None,
    *,
    mechanism_rules: str = "paper",
    wasted: float | None = None,
    repeated: tuple[int, int] | None = None,
) -> ResultRow:
    metrics = Metrics(
        success=rate(*counts),
        key_frames=None if key_frames is None else {key_frames: counts[0]},
        wasted_tries=None if wasted is None else Mean(wasted * counts[0], counts[0]),
        repeated=None if repeated is None else rate(*repeated),
    )
    return ResultRow(subject, mechanism_rules, category, objects, metrics)


def result(**changes: Any) -> ResultFile:
    rows = [
        row("adaptive", "safe", "seen", (19, 20), 14.6),
        row("static", "safe", "seen", (20, 20), 10.25),
        row("adaptive", "lamp", "seen", (9, 10), 6.3),
        row("adaptive", "lamp", "novel", (8, 10), 6.0),
    ]
    made = make_result(
        rows,
        kind="expert",
        title="scripted experts",
        command="python scripts/check_experts.py --category all",
        seeds=[7_000_000, 7_000_030],
        scenes=None,
        seconds=600.0,
    )
    return dataclasses.replace(made, **changes)


def test_documents_are_what_the_script_writes() -> None:
    module = script()
    for path, text in module.documents(module.RESULTS).items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run python scripts/make_results.py"


def test_documents_say_which_versions_were_mixed_or_are_not_the_present_ones(tmp_path: Path) -> None:
    module = script()
    old = {"simulation_version": SIMULATION_VERSION - 1}
    for changes, told in (
        ([{}, {}], ""),
        ([old, old], "Measured with simulation version 2; the present one is 3."),
        ([{}, old], "Measured with simulation versions 2 and 3; the present one is 3."),
        (
            [{"versions": {"torch": each}} for each in ("2.10.0", "2.11.0")],
            "They were measured with different versions installed: torch 2.10.0 and 2.11.0.",
        ),
    ):
        for name, change in zip(("demo", "other"), changes, strict=True):
            write_result(tmp_path / f"{name}.json", result(**change))
        page = module.documents(tmp_path)[module.PAGE]
        assert [line for line in page.splitlines() if line.startswith(("Measured", "They"))] == [told][: len(told)]
        note = "Measured with simulation version" in module.documents(tmp_path)[module.README]
        assert note == ("simulation" in told and changes[0] == old)


def test_a_table_says_what_it_was_measured_with() -> None:
    page = results_page({"experts.json": result()})
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
    assert "| adaptive | lamp | 9/10: 90 % [59.6, 98.2] | 8/10: 80 % [49.0, 94.3] |" in page
    assert "| static | safe | 20/20: 100 % [83.9, 100.0] | - |" in page
    assert "| adaptive | lamp | 6.2 |" in page, "key frames of successes on both kinds of objects"


def test_a_table_of_policies_has_intervals_and_hidden_values() -> None:
    records = [record(seed=k, locked=k % 2 == 0, success=k % 4 != 0) for k in range(20)]
    rows = rows_of_records([*records, records[0]], "dp3_adaptive")
    assert [(each.objects, each.metrics.success) for each in rows] == [("seen", rate(15, 20))]
    measured = {"p.json": result(kind="policy", rows=tuple(rows), scenes="test")}
    told = "| dp3_adaptive | safe | 15/20: 75 % [53.1, 88.8] |"
    page = results_page(measured)
    assert f"{told}\n" in page
    assert "| dp3_adaptive | safe | 12.0 | -0.50 | 0/0 | ajar 5 |" in page
    assert "(test scenes): 15/20: 75 % [53.1, 88.8]\n" in readme_block(measured)
    another = row("dp3_adaptive", "lamp", "seen", (9, 10))
    block = readme_block({"p.json": result(kind="policy", rows=(*rows, another), scenes="test")})
    assert told in block
    assert "wasted tries" not in block
    (line,) = csv.DictReader(csv_table(csv_rows(measured)).splitlines())
    assert (line["subject"], line["successes"], line["episodes"]) == ("dp3_adaptive", "15", "20")
    assert line["hidden"] == "direction +1 15/20, locked 5/10, unlocked 10/10"


def test_a_table_of_policies_ends_with_the_mean_of_categories_where_all_of_them_were_measured() -> None:
    rows = [
        row("ours", "safe", "seen", (9, 10)),
        row("ours", "safe", "unseen", (10, 20)),
        row("ours", "lamp", "seen", (20, 20)),
        row("other", "safe", "seen", (2, 10)),
    ]
    lines = success_table(result(kind="policy", rows=tuple(rows))).splitlines()
    assert lines[0] == "| policy | category | seen objects | unseen objects |"
    assert lines[4] == "| ours | mean of 2 | 95.0 % | - |", "of unseen objects one category alone was measured"
    assert lines[5].startswith("| other | safe | 2/10")
    assert len(lines) == 6


def test_a_result_comes_back_as_it_was(tmp_path: Path) -> None:
    one = result()
    write_result(tmp_path / "results" / "one.json", one)
    assert read_result(tmp_path / "results" / "one.json") == one
    assert re.fullmatch(r"[0-9a-f]{40}", one.commit or "0" * 40)
    assert set(one.machine) == {"cores", "gpu"}


@pytest.mark.parametrize(
    "changes",
    [
        {"simulation_version": "new"}, {"command": "a\nb"}, {"command": "lerobot-eval --x=/home/me/model"},
        {"rows": []}, {"kind": "guess"}, {"schema": 2}, {"host": "machine"}, {"seeds": [1]}, {"scenes": "holdout"},
        {"machine": {"cores": 2, "gpu": False, "name": "x"}}, {"title": "a | b"}, {"seconds": -1}, {"commit": "main"},
    ],
    ids=str,
)  # fmt: skip
def test_a_result_file_that_cannot_be_is_refused(changes: dict[str, Any], tmp_path: Path) -> None:
    content = {**json.loads(json.dumps(result().to_json())), **changes}
    path = tmp_path / "one.json"
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="Not a result file"):
        read_result(path)


def test_a_command_with_a_path_of_this_machine_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="must run elsewhere"):
        make_result(
            [],
            kind="policy",
            title="x",
            command=f"lerobot-eval --policy.path={tmp_path}/x",
            seeds=[1],
            scenes="test",
        )


def test_a_document_has_one_block() -> None:
    assert with_block(f"a\n{START}\nold\n{END}\nb\n", f"{START}\nnew\n{END}") == f"a\n{START}\nnew\n{END}\nb\n"
    for document in ("nothing", f"{START} no end", f"{START}{END}{START}{END}"):
        with pytest.raises(ValueError, match="exactly one block"):
            with_block(document, "x")


def test_the_readme_leaves_to_the_page_what_is_no_result_of_the_papers_rules() -> None:
    """Other rules, scenes that policies are chosen by, and experts once a policy was measured."""
    hard = result(rows=(row("adaptive", "lamp", "seen", (7, 20), 6.3, mechanism_rules="hard"),))
    chosen_by, policy = ({"one.json": result(kind="policy", scenes=scenes)} for scenes in ("validation", "test"))
    for other in (hard, chosen_by["one.json"]):
        page = results_page({"one.json": other})
        assert other.rows[0].metrics.show("success").partition(":")[0] in page
    assert readme_block({"one.json": hard}) == readme_block({})
    assert "(validation scenes" in readme_block(chosen_by)
    assert readme_block({"two.json": chosen_by["one.json"], **policy}) == readme_block(policy)
    experts = {"experts.json": result()}
    assert "novel objects" in readme_block(experts)
    assert readme_block({**experts, **policy}) == readme_block(policy)


def test_results_of_a_benchmark_have_their_part_of_the_page(tmp_path: Path) -> None:
    module, folder = script(), tmp_path / "benchmark" / "cpu"
    alone = module.documents(tmp_path)[module.PAGE]
    assert "Benchmark" not in alone
    folder.mkdir(parents=True)
    run = benchmark(tmp_path / "out", FakeRunner(tmp_path / "fake"))
    for state in run_all(run):
        assert state.result is not None
        named = dataclasses.replace(state.cell, method="dp3_adaptive")
        write_cell(folder / f"{named.name}.json", dataclasses.replace(state.result, cell=named, scale="cpu"))
    page = module.documents(tmp_path)[module.PAGE]
    assert "\n## Benchmark, scale cpu\n" not in alone
    assert "\n## Benchmark, scale cpu\n" in page
    assert re.search(r"^\| dp3_adaptive \(anchors\), seen \| [\d.]+ ‡ \|", page, re.MULTILINE), "of other options"
    assert "| method, objects | safe |\n" in page, "a category without a result is left out"
