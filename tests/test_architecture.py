"""The house: which package may import which, what importing the plugin may cost, how long files and functions get."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "lerobot_adamanip": ROOT / "lerobot_adamanip",
    "lerobot_env_adamanip": ROOT / "envs" / "lerobot_env_adamanip",
    "lerobot_policy_adamanip": ROOT / "policies" / "lerobot_policy_adamanip",
}
MAX_FILE_LINES = 300
MAX_FUNCTION_LINES = 60
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


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_and_functions_stay_short(path: Path) -> None:
    if path.name.startswith("modeling_"):
        return  # networks: one file per policy is LeRobot's rule
    text = path.read_text()
    assert len(text.splitlines()) < MAX_FILE_LINES
    functions = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    too_long = {f.name: n for f in functions if (n := (f.end_lineno or f.lineno) - f.lineno + 1) >= MAX_FUNCTION_LINES}
    assert too_long == {}
