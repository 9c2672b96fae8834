"""A method of another package enters the table by its entry point alone, as docs/extending_policy.md says."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from benchmark_helpers import SCALE, FakeRunner, benchmark, declared

from lerobot_adamanip.benchmark.declaration import METHODS_GROUP, PAPER_TABLE, with_packages
from lerobot_adamanip.benchmark.plan import select_cells
from lerobot_adamanip.benchmark.report import make_report
from lerobot_adamanip.benchmark.report_text import benchmark_page
from lerobot_adamanip.evaluation.results import read_results
from lerobot_adamanip.util.errors import ConfigurationError

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "extending_policy.md").read_text(encoding="utf-8")


def block(mark: str) -> str:
    match = re.search(rf"^<!-- {re.escape(mark)} -->\n```\w+\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert match is not None, mark
    return match[1]


def install(folder: Path, name: str, points: dict[str, str], modules: dict[str, str]) -> None:
    """Puts a distribution into a folder that is on `sys.path`, as pip would."""
    told = folder / f"{name}-1.0.dist-info"
    told.mkdir(parents=True)
    (told / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"{point} = {target}" for point, target in points.items()]
    (told / "entry_points.txt").write_text("\n".join([f"[{METHODS_GROUP}]", *lines, ""]))
    (folder / name).mkdir()
    for module, code in {"__init__.py": "", **modules}.items():
        (folder / name / module).write_text(code)


def hold_still(folder: Path, *, registered: bool) -> None:
    """Installs the package of the page; not registered: what LeRobot has of it is left out."""
    project = tomllib.loads(block("third package: pyproject.toml") + block("third package: entry point"))["project"]
    modules = {"benchmark.py": block(f"third package: {project['name']}/benchmark.py")}
    if registered:
        names = ("__init__.py", "configuration_hold_still.py")
        modules |= {name: block(f"new: my_package/{project['name']}/{name}") for name in names}
    install(folder, project["name"], project["entry-points"][METHODS_GROUP], modules)


def test_it_is_in_the_table_by_its_entry_point_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = declared()
    assert with_packages(before).methods.keys() == before.methods.keys()
    hold_still(tmp_path / "site", registered=False)
    monkeypatch.syspath_prepend(tmp_path / "site")
    declaration = with_packages(before)
    assert declaration.methods["hold_still"].package == "lerobot_policy_hold_still"
    made = benchmark(tmp_path / "out", FakeRunner(tmp_path), declaration)
    wanted = select_cells(declaration, SCALE, methods=("hold_still",))
    assert [each.state for each in made.run(wanted)] == ["done"] * 2
    results = list(read_results(made.folder.cells).values())
    assert results[0].run is not None
    assert "--policy.type=hold_still --policy.gripper=0.5" in results[0].run.steps["train"].command
    for known in (declaration, before):  # whoever reads the files need not have the package
        page = benchmark_page(make_report(results, known, SCALE))
        assert re.search(r"^\| Hold still \(lerobot_policy_hold_still\), seen \| [\d.]+/[\d.]+ \|", page, re.MULTILINE)


@pytest.mark.nightly
def test_the_command_lists_it_unless_another_declaration_is_given(tmp_path: Path) -> None:
    """And lists the method that docs/benchmark.md declares, in its declaration."""
    hold_still(tmp_path, registered=True)
    page = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    method, *_ = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "mine.toml").write_text(PAPER_TABLE.read_text(encoding="utf-8") + method)
    paths = os.pathsep.join([str(tmp_path), str(ROOT), str(ROOT / "envs"), str(ROOT / "policies")])
    line = [sys.executable, "-m", "lerobot_adamanip.cli.main", "benchmark", "--list", "--json", "--scale", "smoke"]

    def listed(*options: str) -> dict[str, str]:
        done = subprocess.run(
            [*line, "--out", "out", *options],
            env={**os.environ, "PYTHONPATH": paths},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        cells = json.loads(done.stdout)["cells"]
        assert all(cell["reason"] for cell in cells if cell["state"] == "unavailable")
        return {cell["name"]: cell["state"] for cell in cells}

    alone, mine = listed(), listed("--config", "mine.toml")
    assert {alone["hold_still-safe-seen-1000"], mine["diffusion_policy-safe-seen-1000"]} == {"missing"}
    assert set(alone) & set(mine) == {name for name in alone if not name.startswith("hold_still")}
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("METHOD = {'title': 'x'}", "ours_too needs a policy"),
        ("METHOD = {'title': 'x', 'policy': 'x', 'demonstrations': 'some'}", "demonstrations is 'some'"),
        ("METHOD = 3", "named fields"),
        ("1 / 0", "division by zero"),
    ],
)
def test_one_that_cannot_be_used_is_one_error_that_names_its_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, message: str
) -> None:
    name = f"theirs_{tmp_path.name}"  # modules are imported once
    install(tmp_path, name, {"ours_too": f"{name}.benchmark:METHOD"}, {"benchmark.py": code})
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigurationError, match=message) as error:
        with_packages(declared())
    assert name in str(error.value)


def test_a_name_that_no_result_can_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "METHOD = {'title': 'x', 'policy': 'x', 'demonstrations': 'static'}"
    install(tmp_path, "still", {"hold-still": "still.benchmark:METHOD"}, {"benchmark.py": code})
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigurationError, match="small letters"):
        with_packages(declared())


def test_two_methods_of_one_name_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "theirs", {"ours": "theirs.benchmark:METHOD"}, {"benchmark.py": "METHOD = {}"})
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigurationError, match="has a method of that name"):
        with_packages(declared())
