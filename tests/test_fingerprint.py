"""A fingerprint covers all code that decides a result, by its import closure."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lerobot_adamanip.benchmark.plan import NUMBERS
from lerobot_adamanip.collection.fingerprint import RECORDING
from lerobot_adamanip.evaluation.provenance import EQUIVALENT, equivalent_fingerprints
from lerobot_adamanip.util.fingerprint import DECIDES_NOTHING, code_closure, code_hash
from lerobot_adamanip.util.import_graph import ImportGraph, is_within, our_import_graph
from lerobot_env_adamanip.fingerprint import ENVIRONMENT, EXPERTS, PARTS, code_fingerprint

POLICIES = ("adaafford", "dp3_adaptive", "sampling", "vat_mart")
TRAINING = tuple(
    f"lerobot_policy_adamanip.{name}.{kind}_{name}"
    for name in POLICIES
    for kind in ("configuration", "modeling", "processor")
)
# Each had been left out of a list of files once, or is reached in a way of its own.
MUST_COVER = {
    ENVIRONMENT: (
        "lerobot_adamanip.contract.seeds",
        "lerobot_adamanip.episode.options",
        "lerobot_adamanip.objects.lamp.novel",
        "lerobot_env_adamanip.cloud_source",
        "lerobot_env_adamanip.episode_log",
        "lerobot_env_adamanip.sim.mechanism_driver",
    ),
    EXPERTS: ("lerobot_adamanip.experts.lamp", "lerobot_adamanip.mechanisms.table"),
    RECORDING: (
        "lerobot_adamanip.collection.corrections",
        "lerobot_adamanip.collection.late_starts",
        "lerobot_adamanip.collection.recorder",
        "lerobot_adamanip.datasets.encoding",
        "lerobot_adamanip.datasets.statistics",
    ),
    TRAINING: (
        "lerobot_adamanip.lerobot_patches.batched_reading",
        "lerobot_policy_adamanip.common.losses",
        "lerobot_policy_adamanip.common.recorded_rows",
    ),
    NUMBERS: ("lerobot_adamanip.evaluation.rates", "lerobot_adamanip.evaluation.record"),
}


@pytest.fixture
def graph(tmp_path: Path) -> ImportGraph:
    files = {
        "start.py": "from typing import TYPE_CHECKING\nfrom pkg import near\nif TYPE_CHECKING:\n    import pkg.typed\n",
        "near.py": "def later():\n    from .inner.far import value\n",
        "inner/__init__.py": "",
        "inner/far.py": "def load(n):\n    return import_module(f'pkg.kinds.{n}')\n",
        "kinds/safe.py": "",
        "typed.py": "",
        "apart.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return ImportGraph({"pkg": tmp_path})


def test_a_closure_has_all_that_runs_and_nothing_else(graph: ImportGraph) -> None:
    reached = {"pkg.start", "pkg.near", "pkg.inner", "pkg.inner.far", "pkg.kinds.safe"}
    assert graph.closure(["pkg.start"]) == reached
    assert graph.closure(["pkg.start"], leave_out=["pkg.inner"]) == {"pkg.start", "pkg.near"}
    with pytest.raises(KeyError):
        graph.closure(["pkg.misspelt"])


def test_a_hash_follows_code_and_not_remarks(graph: ImportGraph) -> None:
    modules = graph.closure(["pkg.start"])
    before = code_hash(modules, graph)
    file = graph.modules["pkg.kinds.safe"]
    file.write_text('"""Says more."""\n\n# a remark\n')
    assert code_hash(modules, graph) == before
    file.write_text("depth = 1\n")
    assert code_hash(modules, graph) != before


@pytest.mark.parametrize("entries", MUST_COVER, ids=("environment", "experts", "rows", "trainings", "numbers"))
def test_what_decides_is_in_the_closure(entries: tuple[str, ...]) -> None:
    assert set(MUST_COVER[entries]) <= code_closure(*entries)


def test_no_module_of_a_closure_is_missing_from_it() -> None:
    """Whatever a module of a closure imports is in the closure, or is named as deciding nothing."""
    graph = our_import_graph()
    for entries in MUST_COVER:
        closure = code_closure(*entries)
        for module in closure:
            beyond = graph.imports(module) - closure - graph.roots.keys()
            assert all(is_within(each, DECIDES_NOTHING) for each in beyond), (module, beyond)


def test_every_exception_is_one() -> None:
    graph = our_import_graph()
    everything = graph.closure([entry for entries in MUST_COVER for entry in entries])
    for name in DECIDES_NOTHING:
        assert any(is_within(module, (name,)) for module in everything), name


def test_every_part_of_an_episode_has_modules() -> None:
    covered = code_closure(*ENVIRONMENT)
    assert set(code_fingerprint()) == {*PARTS, "contract", "experts"}
    for packages in PARTS.values():
        assert any(is_within(module, packages) for module in covered), packages


def test_equivalents_are_those_of_the_table_alone(tmp_path: Path) -> None:
    table = tmp_path / "table.json"
    rows = [("a", "b"), ("b", "c"), ("x", "y")]
    table.write_text(json.dumps([{"old": old, "new": new, "shown_by": "make demo"} for old, new in rows]))
    assert equivalent_fingerprints({"c"}, table) == {"a", "b", "c"}
    assert equivalent_fingerprints({"z"}, table) == {"z"}


def test_each_equivalence_names_the_command_that_showed_it() -> None:
    for row in json.loads(EQUIVALENT.read_text(encoding="utf-8")):
        assert row.keys() == {"old", "new", "shown_by"}
        assert all(row.values())
