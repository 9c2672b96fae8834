"""The house: which package may import which, what importing the plugin may cost, how long files and functions get."""

from __future__ import annotations

import ast
import functools
import io
import json
import re
import subprocess
import sys
import tokenize
from pathlib import Path
from token import COMMENT

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "lerobot_adamanip": ROOT / "lerobot_adamanip",
    "lerobot_env_adamanip": ROOT / "envs" / "lerobot_env_adamanip",
    "lerobot_policy_adamanip": ROOT / "policies" / "lerobot_policy_adamanip",
}
CLI = PACKAGES["lerobot_adamanip"] / "cli"
MAX_FILE_LINES, MAX_TABLE_LINES, MAX_FUNCTION_LINES = 300, 350, 40
MODULE_OF_OTHERS = re.compile(r"(lerobot_env_adamanip|lerobot_policy_adamanip|sapien|mani_skill|diffusers)[.:]\w")
IMPORTS_FROM_TABLES = {"lerobot_adamanip/cli/main.py"}
"""Files that import what a table of constants in the same file names."""
NOT_IN_CORE = ("sapien", "mani_skill", "diffusers", "lerobot_env_adamanip", "lerobot_policy_adamanip")
TOO_HEAVY_FOR_A_PLUGIN = (
    "sapien",
    "mani_skill",
    "diffusers",
    "trimesh",
    "matplotlib",
    "scipy.spatial",
    "gymnasium.vector",
)
SOURCES = sorted(path for folder in PACKAGES.values() for path in folder.rglob("*.py"))


def module_names(package: str) -> list[str]:
    folder = PACKAGES[package]
    parts = (path.relative_to(folder.parent).with_suffix("").parts for path in folder.rglob("*.py"))
    return sorted(".".join(p[:-1] if p[-1] == "__init__" else p) for p in parts)


def core_modules() -> list[str]:
    return [name for name in module_names("lerobot_adamanip") if not name.startswith("lerobot_adamanip.cli")]


def in_fresh_process(code: str) -> object:
    """Runs code that prints JSON on its last line in a process that has imported nothing of ours."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.strip().splitlines()[-1])


# LeRobot imports diffusers by itself, so being loaded proves nothing: a finder notes who asked first.
WATCH_IMPORTS = """
import importlib, json, sys
watched, asked = set({watched!r}), []
class Watch:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name in watched:
            frame = sys._getframe(1)
            while frame is not None and "importlib" in frame.f_globals.get("__name__", "importlib"):
                frame = frame.f_back
            asked.append((name, frame.f_globals["__name__"] if frame else "?"))
sys.meta_path.insert(0, Watch)
for module in {modules!r}:
    importlib.import_module(module)
print(json.dumps(asked))
"""


def test_core_brings_no_simulator_diffusers_or_driver() -> None:
    asked = in_fresh_process(WATCH_IMPORTS.format(watched=NOT_IN_CORE, modules=core_modules()))
    assert isinstance(asked, list)
    wrong = [(name, by) for name, by in asked if not (name == "diffusers" and by.split(".")[0] == "lerobot")]
    assert wrong == []


def imported_names(path: Path) -> set[str]:
    """Top-level packages that a file imports anywhere, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.partition(".")[0])
    return names


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_arrows_point_one_way(path: Path) -> None:
    forbidden: set[str]
    if path.is_relative_to(PACKAGES["lerobot_env_adamanip"]):
        forbidden = {"diffusers"}
    elif path.is_relative_to(PACKAGES["lerobot_policy_adamanip"]):
        forbidden = {"sapien", "mani_skill", "lerobot_env_adamanip"}
    elif path.is_relative_to(PACKAGES["lerobot_adamanip"] / "cli"):
        forbidden = set()
    else:
        forbidden = {"sapien", "mani_skill", "diffusers"}
    if path == PACKAGES["lerobot_env_adamanip"] / "__init__.py":
        forbidden |= {"sapien", "mani_skill"}
    assert imported_names(path) & (forbidden | {"mplib", "pytorch3d", "pickle"}) == set()


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


def test_help_does_not_import_what_the_commands_need() -> None:
    code = """
import contextlib, io, json, sys
from lerobot_adamanip.cli.main import main
with contextlib.redirect_stdout(io.StringIO()):
    assert main(["--help"]) == 0
print(json.dumps([m for m in ("torch", "lerobot", "numpy", "tyro", "sapien", "mani_skill") if m in sys.modules]))
"""
    assert in_fresh_process(code) == []


# House rules that a graph of imports cannot tell -------------------------------------------------------------------


@functools.cache
def trees() -> tuple[tuple[Path, ast.Module], ...]:
    return tuple((path, ast.parse(path.read_text(encoding="utf-8"))) for path in SOURCES)


def module_of(path: Path) -> str:
    (home,) = [folder for folder in PACKAGES.values() if path.is_relative_to(folder)]
    parts = path.relative_to(home.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def for_type_checkers(tree: ast.Module) -> set[ast.AST]:
    """What stands under `if TYPE_CHECKING`, and never runs."""
    guarded = [n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    return {node for each in guarded for node in ast.walk(each)}


def import_graph() -> dict[str, set[str]]:
    """Module -> modules of ours it imports, in functions too."""
    found = {module_of(path): (path, tree) for path, tree in trees()}
    graph: dict[str, set[str]] = {}
    for name, (path, tree) in found.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        wanted: set[str] = set()
        for node in set(ast.walk(tree)) - for_type_checkers(tree):
            if isinstance(node, ast.Import):
                wanted |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = package.rsplit(".", node.level - 1)[0] + "." if node.level else ""
                source = f"{base}{node.module or ''}".rstrip(".")
                # `from package import module` imports the module, `from module import name` the module it is from.
                each = {f"{source}.{alias.name}" for alias in node.names}
                wanted |= {name if name in found else source for name in each}
        graph[name] = {each for each in wanted if each in found} - {name}
    return graph


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Returns the modules of one import circle, empty if there is none."""
    done: set[str] = set()

    def visit(name: str, trail: list[str]) -> list[str]:
        if name in trail:
            return [*trail[trail.index(name) :], name]
        if name in done:
            return []
        done.add(name)
        return next((found for each in sorted(graph[name]) if (found := visit(each, [*trail, name]))), [])

    return next((found for name in sorted(graph) if (found := visit(name, []))), [])


def test_a_circle_would_be_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_no_import_circle() -> None:
    graph = import_graph()
    assert sum(map(len, graph.values())) > 200  # it sees something
    assert circle(graph) == []


def rooms() -> dict[str, set[str]]:
    """Folder or file right under the core -> those that it imports."""

    def room(name: str) -> str:
        return ".".join(name.split(".")[:2])

    found: dict[str, set[str]] = {}
    for name, imported in import_graph().items():
        if name.startswith("lerobot_adamanip."):
            there = {room(each) for each in imported if each.startswith("lerobot_adamanip.")}
            found.setdefault(room(name), set()).update(there - {room(name)})
    return found


def test_no_circle_of_rooms() -> None:
    """Not only no file, no folder of the core leans on one that leans on it."""
    assert circle(rooms()) == []


def docstrings(tree: ast.Module) -> set[ast.expr]:
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    }


def test_the_core_names_no_module_of_others_in_a_string() -> None:
    """What must not be imported must not be imported by name either; a distribution's name alone is none."""
    wrong = []
    for path, tree in trees():
        if not path.is_relative_to(PACKAGES["lerobot_adamanip"]) or path.is_relative_to(CLI):
            continue
        for node in set(ast.walk(tree)) - docstrings(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and MODULE_OF_OTHERS.match(node.value):
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}: {node.value}")
    assert wrong == []


def test_modules_are_imported_by_string_only_from_our_own_tables() -> None:
    """Never by what data say: a constant, a name within our own package, or a row of a table of ours."""
    wrong = []
    for path, tree in trees():
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            name = ast.unparse(call.func)  # `policy.eval()` is none of these
            if name.removeprefix("importlib.") not in ("import_module", "__import__", "eval", "exec"):
                continue
            argument = call.args[0] if call.args else call.func
            if isinstance(argument, ast.JoinedStr):
                argument = argument.values[0]
            constant = isinstance(argument, ast.Constant) and str(argument.value).startswith("lerobot_")
            table = isinstance(argument, ast.Name) and argument.id.isupper()
            if not (constant or table or str(path.relative_to(ROOT)) in IMPORTS_FROM_TABLES):
                wrong.append(f"{path.relative_to(ROOT)}:{call.lineno}")
    assert wrong == []


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
    for path in [*SOURCES, *(ROOT / "tests").rglob("*.py"), *(ROOT / "scripts").glob("*.py")]:
        text = path.read_text(encoding="utf-8")
        tables = {node.end_lineno for node in ast.walk(ast.parse(text)) if is_table_statement(node)}
        comments = (token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type == COMMENT)
        for token in comments:
            if "fmt: off" in token.string or ("fmt: skip" in token.string and token.start[0] not in tables):
                wrong.append(f"{path.relative_to(ROOT)}:{token.start[0]}")
    assert wrong == []


def table_lines(tree: ast.Module) -> int:
    """Lines of a file's tables, wherever they stand in it."""
    rows = [node for node in ast.walk(tree) if isinstance(node, ast.Assign | ast.AnnAssign) and is_table(node.value)]
    return len({line for node in rows for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)})


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_and_functions_stay_short(path: Path) -> None:
    """The one bar: see CONTRIBUTING.md."""
    if path.name.startswith("modeling_"):
        return  # networks: one file per policy is LeRobot's rule
    text = path.read_text(encoding="utf-8")
    tree, lines = ast.parse(text), len(text.splitlines())
    assert lines < (MAX_TABLE_LINES if 2 * table_lines(tree) > lines else MAX_FILE_LINES)
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    too_long = {f.name: n for f in functions if (n := (f.end_lineno or f.lineno) - f.lineno + 1) >= MAX_FUNCTION_LINES}
    assert too_long == {}


def test_the_bar_is_the_one_written_down() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert f"under {MAX_FILE_LINES} lines (tables of data under {MAX_TABLE_LINES})" in text
    assert f"functions under {MAX_FUNCTION_LINES}" in text


def test_a_package_that_has_a_face_says_which() -> None:
    """`__all__` in every package that offers names of its modules, of names that are there."""
    for path, tree in trees():
        if path.name != "__init__.py":
            continue
        nodes = [node for top in tree.body for node in (ast.walk(top) if isinstance(top, ast.If) else (top,))]
        offers = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module != "__future__"]
        stated = [
            node for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        ]
        assert bool(stated) == bool(offers), path.relative_to(ROOT)
        if stated:
            bound = {alias.asname or alias.name for node in offers for alias in node.names}
            bound |= {name.id for node in tree.body for name in ast.walk(node) if isinstance(name, ast.Name)}
            bound |= {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
            names = {n.value for n in ast.walk(stated[0].value) if isinstance(n, ast.Constant)}
            assert names <= bound, path.relative_to(ROOT)


ON_THE_WAY = (
    "keyframe_env",
    "episode_log",
    "sim.tasks.base",
    "sim.keyframe_driver",
    "sim.mechanism_driver",
    "sim.camera",
)
OFF_THE_WAY = {
    "compute_sparse_reward",  # ManiSkill's signatures, for who uses the task without key frames
    "sim.tasks.base: step",
    "__init__ state",  # a hidden draw: each mechanism has a type of its own
}


def bare_any(tree: ast.Module) -> list[str]:
    """Arguments, results and attributes annotated as nothing but `Any`; `*args` and `**kwargs` are left out."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            found += [f"{node.name} {each.arg}" for each in arguments if is_any(each.annotation)]
            found += [node.name] if is_any(node.returns) else []
        elif isinstance(node, ast.AnnAssign) and is_any(node.annotation):
            found.append(ast.unparse(node.target))
    return [name for name in found if not {name, name.split()[0]} & OFF_THE_WAY]


def is_any(annotation: ast.expr | None) -> bool:
    return annotation is not None and ast.unparse(annotation) in ("Any", "Any | None", "Optional[Any]")


def test_an_action_is_typed_on_its_whole_way_to_the_simulator() -> None:
    assert bare_any(ast.parse("def step(self, action: Any) -> None: ...\nself._sim: Any = None")) == [
        "step action",
        "self._sim",
    ]
    for path, tree in trees():
        if module_of(path).removeprefix("lerobot_env_adamanip.") in ON_THE_WAY:
            name = module_of(path).removeprefix("lerobot_env_adamanip.")
            left = [each for each in bare_any(tree) if f"{name}: {each.split()[0]}" not in OFF_THE_WAY]
            assert left == [], name
    attributes = {
        ast.unparse(node.target): ast.unparse(node.annotation)
        for path, tree in trees()
        if path.name == "keyframe_env.py"
        for node in ast.walk(tree)
        if isinstance(node, ast.AnnAssign)
    }
    assert attributes["self._sim"] == "AdaManipTask | None"
