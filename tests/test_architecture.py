"""The house rules: which package may import which, what importing costs, how long files and functions get."""

from __future__ import annotations

import ast
import functools
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
CORE = "lerobot_adamanip"
PACKAGES = (ROOT / CORE, ROOT / "envs/lerobot_env_adamanip", ROOT / "policies/lerobot_policy_adamanip")
MAX_FILE_LINES, MAX_FUNCTION_LINES = 500, 60
MODULE_OF_OTHERS = re.compile(r"(lerobot_env_adamanip|lerobot_policy_adamanip|sapien|mani_skill|diffusers)[.:]\w")
TOO_HEAVY_FOR_A_PLUGIN = (
    "sapien", "mani_skill", "diffusers", "trimesh", "matplotlib", "scipy.spatial", "gymnasium.vector",
)  # fmt: skip


@functools.cache
def sources() -> dict[str, tuple[Path, str, ast.Module]]:
    """Module -> file, text and syntax tree."""
    found = {}
    for package in PACKAGES:
        for path in sorted(package.rglob("*.py")):
            name = ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__")
            text = path.read_text(encoding="utf-8")
            found[name] = (path, text, ast.parse(text))
    return found


def in_fresh_process(code: str) -> object:
    """Runs code that prints JSON on its last line in a process that has imported nothing of ours."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.strip().splitlines()[-1])


# Imports ----------------------------------------------------------------------------------------------------------


def test_the_contracts_of_import_linter_hold() -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([lint, "--no-cache"], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout


def test_plugin_registration_imports_nothing_heavy() -> None:
    """Every lerobot-* command pays for this import. Counted in modules, because wall time depends on the machine."""
    code = f"""
import json, sys
import lerobot.configs.policies, lerobot.envs.configs
from lerobot.utils.import_utils import register_third_party_plugins
before = set(sys.modules)
register_third_party_plugins()
added = sorted(set(sys.modules) - before)
heavy, ours = [m for m in added if m in {TOO_HEAVY_FOR_A_PLUGIN!r}], [m for m in added if "adamanip" in m]
print(json.dumps({{"heavy": heavy, "ours": ours}}))
"""
    found = in_fresh_process(code)
    assert isinstance(found, dict)
    assert "lerobot_env_adamanip" in found["ours"]
    assert found["heavy"] == []


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Returns the names of one circle of imports, empty if there is none."""
    done: set[str] = set()

    def visit(name: str, trail: list[str]) -> list[str]:
        if name in trail:
            return [*trail[trail.index(name) :], name]
        if name in done:
            return []
        done.add(name)
        return next((found for each in sorted(graph[name]) if (found := visit(each, [*trail, name]))), [])

    return next((found for name in sorted(graph) if (found := visit(name, []))), [])


def test_no_import_circle_of_modules() -> None:
    """Layers without circles of folders are import-linter's."""
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    graph = grimp.build_graph(*(each.name for each in PACKAGES), exclude_type_checking_imports=True, cache_dir=None)
    modules = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    assert sum(map(len, modules.values())) > 200  # it sees something
    assert circle(modules) == []


def docstrings(tree: ast.Module) -> set[ast.expr]:
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    }


def test_the_core_names_no_module_of_others_in_a_string() -> None:
    """What must not be imported must not be imported by name either; a distribution's name alone is none."""
    wrong = []
    for name, (_, _, tree) in sources().items():
        if not f"{name}.".startswith(f"{CORE}.") or name.startswith((f"{CORE}.cli",)):
            continue
        for node in set(ast.walk(tree)) - docstrings(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and MODULE_OF_OTHERS.match(node.value):
                wrong.append(f"{name}:{node.lineno}: {node.value}")
    assert wrong == []


def test_modules_are_imported_by_string_only_from_our_own_tables() -> None:
    """Never by what data say: a constant, a name within our own package, or a row of a table of ours."""
    wrong = []
    for name, (_, _, tree) in sources().items():
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            function = ast.unparse(call.func)  # `policy.eval()` is none of these
            if function.removeprefix("importlib.") not in ("import_module", "__import__", "eval", "exec"):
                continue
            argument = call.args[0] if call.args else call.func
            if isinstance(argument, ast.JoinedStr):
                argument = argument.values[0]
            constant = isinstance(argument, ast.Constant) and str(argument.value).startswith("lerobot_")
            table = isinstance(argument, ast.Name) and argument.id.isupper()
            if not (constant or table):
                wrong.append(f"{name}:{call.lineno}")
    assert wrong == []


# Places -----------------------------------------------------------------------------------------------------------


def test_no_loose_module_at_the_top_of_the_core() -> None:
    loose = {path.name for path in (ROOT / CORE).iterdir() if path.is_file()}
    assert loose == {"__init__.py", "catalog.py", "py.typed"}


SIDE_EFFECTS = """
import os, signal, sys
hooks = []
os.register_at_fork = lambda **functions: hooks.extend(functions.values())
def state():
    handlers = [signal.getsignal(number) for number in signal.valid_signals()]
    return list(sys.meta_path), list(sys.path_hooks), dict(os.environ), handlers
before = state()
import lerobot_adamanip, lerobot_adamanip.datasets.output_folder, lerobot_adamanip.util.jobs
assert state() == before
assert not [hook for hook in hooks if hook.__module__.startswith("lerobot_adamanip")], hooks
"""


def test_importing_the_core_changes_nothing_of_the_process() -> None:
    subprocess.run([sys.executable, "-c", SIDE_EFFECTS], check=True)


# Names ------------------------------------------------------------------------------------------------------------

FAMILIES = ("lerobot_adamanip.objects.", "lerobot_adamanip.experts.")
"""Folders whose modules have one interface: the same functions for each category."""
DEFINED_TWICE = {
    "main", "apply", "restore", "count", "add", "encode", "decode", "to_json", "Demonstrations", "angle_between",
    "matrix_from_rotation_vector", "camera_of", "distance", "in_order", "placement_check", "pose_error",
}  # fmt: skip
"""Public names with two meanings. The list only gets shorter."""


def test_one_name_has_one_meaning() -> None:
    """A public class or function is defined once over all packages."""
    places: dict[str, list[str]] = {}
    for module, (_, _, tree) in sources().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not f"{module}.".startswith(FAMILIES):
                places.setdefault(node.name, []).append(module)
    twice = {name: modules for name, modules in places.items() if len(modules) > 1 and not name.startswith("_")}
    assert {name: modules for name, modules in twice.items() if name not in DEFINED_TWICE} == {}


# Lengths ----------------------------------------------------------------------------------------------------------


def is_table(value: ast.expr | None) -> bool:
    """Whether an expression is a display: rows written out, not something computed."""
    return isinstance(value, ast.Dict | ast.Tuple | ast.List | ast.Set)


def is_table_statement(node: ast.AST) -> bool:
    """Whether a table is all there is to a statement: a named one, or the cases of a test."""
    if isinstance(node, ast.Assign | ast.AnnAssign | ast.Return):
        return is_table(node.value)
    return isinstance(node, ast.Call) and ast.unparse(node.func).endswith("parametrize") and is_table(node.args[1])


def test_the_formatter_is_kept_off_tables_only() -> None:
    wrong = []
    for path in (
        path for folder in (CORE, "envs", "policies", "tests", "scripts") for path in (ROOT / folder).rglob("*.py")
    ):
        text = path.read_text(encoding="utf-8")
        skipped = {at for at, line in enumerate(text.splitlines(), 1) if "# fmt:" in line and '"# fmt:' not in line}
        if skipped:
            tables = {node.end_lineno for node in ast.walk(ast.parse(text)) if is_table_statement(node)}
            wrong += [f"{path.relative_to(ROOT)}:{at}" for at in skipped - tables]
    assert wrong == []


def too_long() -> Iterator[str]:
    for name, (path, text, tree) in sources().items():
        if path.name.startswith("modeling_"):
            continue  # networks: one file per policy is LeRobot's rule
        lines = len(text.splitlines())
        if lines >= MAX_FILE_LINES:
            yield f"{name}: {lines} lines"
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if length >= MAX_FUNCTION_LINES:
                    yield f"{name}.{node.name}: {length} lines"


def test_files_and_functions_stay_short() -> None:
    """The one bar; CONTRIBUTING.md tells it."""
    assert list(too_long()) == []
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert f"under {MAX_FILE_LINES} lines" in text
    assert f"functions under {MAX_FUNCTION_LINES}" in text


def test_quick_tests_exist() -> None:
    match = re.search(r"^QUICK := ((?:.*\\\n)*.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert match is not None
    names = match[1].replace("\\\n", " ").split()
    assert [name for name in names if not (ROOT / name).exists()] == []
