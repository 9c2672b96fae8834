"""The wheel: what is in it, and that LeRobot finds its parts where nothing else of this checkout is."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import lerobot_adamanip

ROOT = Path(__file__).resolve().parents[1]
SHOW_REGISTRATIONS = """
import json, lerobot_adamanip, lerobot_env_adamanip, lerobot_policy_adamanip
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.utils.import_utils import register_third_party_plugins
register_third_party_plugins()
modules = (lerobot_adamanip, lerobot_env_adamanip, lerobot_policy_adamanip)
print(json.dumps({"env": sorted(EnvConfig.get_known_choices()), "policy": sorted(PreTrainedConfig.get_known_choices()),
                  "files": [m.__file__ for m in modules]}))
"""


def run(command: list[str], **kwargs: object) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, **kwargs)  # type: ignore[call-overload]
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return str(done.stdout)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built without build isolation: hatchling is one of the dev packages, so nothing is downloaded."""
    folder = tmp_path_factory.mktemp("wheel")
    run([sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)])
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def empty_environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel alone; the dependencies are seen through links to this one's packages.

    Links, one per installed package, rather than a .pth line with the whole folder: that one holds the editable
    installation of this checkout, and the test would find the sources instead of the wheel.
    """
    folder = tmp_path_factory.mktemp("empty") / "venv"
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    site = Path(run([str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]).strip())
    with zipfile.ZipFile(wheel) as archive:
        names = [n for n in archive.namelist() if not n.endswith("/")]
    run(
        [
            sys.executable,
            "-m",
            "pip",
            "--python",
            str(python),
            "install",
            "--no-deps",
            "--no-index",
            "--quiet",
            str(wheel),
        ]
    )
    assert all((site / n).exists() for n in names)
    for package in Path(sysconfig.get_path("purelib")).iterdir():
        if "adamanip" not in package.name and not (site / package.name).exists():
            (site / package.name).symlink_to(package)
    return python


def test_wheel_holds_all_packages_and_no_tests(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {name.partition("/")[0] for name in names if ".dist-info" not in name} == {
        "lerobot_adamanip",
        "lerobot_env_adamanip",
        "lerobot_policy_adamanip",
    }
    packages = ("lerobot_adamanip", "lerobot_env_adamanip", "lerobot_policy_adamanip")
    assert {f"{package}/py.typed" for package in packages} <= names
    assert not [name for name in names if "test" in Path(name).name or "/tests/" in name]
    cards = {p.relative_to(ROOT).as_posix() for p in (ROOT / "hub_cards").rglob("*") if p.is_file()}
    assert cards
    assert {f"lerobot_adamanip/{card}" for card in cards} <= names
    sources = {p.relative_to(ROOT).as_posix() for p in (ROOT / "lerobot_adamanip").rglob("*.py")}
    assert sources <= names


def test_wheel_name_is_one_that_lerobot_looks_for(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (path,) = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA")]
        lines = archive.read(path).decode().splitlines()
        assert [n for n in archive.namelist() if n.endswith("licenses/LICENSE")]
    assert "Name: lerobot_env_adamanip" in lines
    assert "License-Expression: Apache-2.0" in lines


def test_lerobot_finds_everything_from_the_wheel(empty_environment: Path, tmp_path: Path) -> None:
    variables = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    answer = run([str(empty_environment), "-c", SHOW_REGISTRATIONS], cwd=tmp_path, env=variables)
    found = json.loads(answer.strip().splitlines()[-1])
    assert "adamanip_safe" in found["env"]
    assert "dp3_adaptive" in found["policy"]
    assert all(Path(f).is_relative_to(empty_environment.parent.parent) for f in found["files"])


def test_wheel_installs_the_command(empty_environment: Path, tmp_path: Path) -> None:
    command = empty_environment.parent / "adamanip"
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert run([str(command), "--version"], cwd=tmp_path).strip() == f"adamanip {version}"


def test_constraints_pin_every_dependency() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert all(line.count("==") == 1 and "@" not in line and "://" not in line for line in lines)
    pinned = {line.partition("==")[0].lower().replace("_", "-") for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["sim"] + project["optional-dependencies"]["dev"]
    assert {Requirement(w).name.lower().replace("_", "-") for w in wanted} <= pinned


def test_one_version() -> None:
    """In the distribution, the package and the citation."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert lerobot_adamanip.__version__ == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()


def test_every_extra_is_imported_by_something() -> None:
    """An extra that no line imports promises what is not there."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    modules = {"mani-skill": "mani_skill", "opencv-python": "cv2", "pycollada": "collada"}
    packages = ("lerobot_adamanip", "envs", "policies")
    text = "\n".join(p.read_text() for folder in packages for p in (ROOT / folder).rglob("*.py"))
    for extra in set(extras) - {"dev"}:
        for name in (Requirement(line).name for line in extras[extra]):
            assert re.search(rf"\b(import|from) {modules.get(name, name)}\b", text), f"{extra}: {name}"


@pytest.mark.parametrize("script", [*(ROOT / "scripts").glob("*.sh"), ROOT / ".ci" / "run"], ids=lambda p: p.name)
def test_scripts_are_bash(script: Path) -> None:
    assert os.access(script, os.X_OK) or script.name == "setup_common.sh"  # sourced
    run(["bash", "-n", str(script)])
