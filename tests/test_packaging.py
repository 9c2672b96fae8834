"""The wheel: what is in it, and that LeRobot finds its parts where nothing else of this checkout is."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from smoke_test_release import ReleaseError, check_tag, find_wheel

import lerobot_adamanip

ROOT = Path(__file__).resolve().parents[1]
TEXT = {".py", ".json", ".typed", ".toml", ".md", ".txt", ".cff", ""}
"""Endings of what a release holds; the last one is that of LICENSE, PKG-INFO and .gitignore."""


def run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def tracked(folder: str) -> set[str]:
    """Files of a folder of the checkout that a release may hold: those that are no build product."""
    found = (ROOT / folder).rglob("*")
    return {path.relative_to(ROOT).as_posix() for path in found if path.is_file() and "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Source archive, and the wheel built of what is in it.

    Without build isolation: hatchling is one of the dev packages, so nothing is downloaded.
    """
    folder = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)])
    return folder


@pytest.fixture(scope="module")
def wheel(dist: Path) -> Path:
    return find_wheel(dist)


def test_wheel_and_source_archive_hold_the_packages_and_no_binaries(dist: Path, wheel: Path) -> None:
    packages = {
        "lerobot_adamanip": ROOT,
        "lerobot_env_adamanip": ROOT / "envs",
        "lerobot_policy_adamanip": ROOT / "policies",
    }
    wanted = {f"lerobot_adamanip/{path}" for path in tracked("hub_cards")}
    for package, home in packages.items():
        wanted |= {(ROOT / path).relative_to(home).as_posix() for path in tracked((home / package).as_posix())}
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (told,) = [name for name in names if name.endswith(".dist-info/METADATA")]
        assert "Name: lerobot_env_adamanip" in archive.read(told).decode().splitlines()  # LeRobot looks for such names
    assert [name for name in names if name.endswith("licenses/LICENSE")]
    in_wheel = {name for name in names if ".dist-info/" not in name}
    assert in_wheel == wanted
    assert {f"{package}/py.typed" for package in packages} | {"lerobot_adamanip/benchmark/paper_table.toml"} <= wanted

    (path,) = dist.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        in_archive = {name.partition("/")[2] for name in archive.getnames()}
    folders = ("lerobot_adamanip", "envs", "policies", "hub_cards")
    files = ("CHANGELOG.md", "CITATION.cff", "LICENSE", "README.md", "constraints.txt", "pyproject.toml")
    assert in_archive == {*files, "PKG-INFO", ".gitignore", *(path for folder in folders for path in tracked(folder))}
    assert {Path(name).suffix for name in in_wheel | in_archive} <= TEXT


@pytest.mark.nightly
def test_the_release_works_in_an_environment_of_its_own(dist: Path) -> None:
    done = smoke_test(dist, "--no-simulator")
    assert done.returncode == 0, done.stdout + done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["ok"] * 3


@pytest.mark.nightly
@pytest.mark.sim
@pytest.mark.timeout(900)  # `adamanip doctor` renders, in a process of its own
def test_an_environment_of_the_release_resets(dist: Path) -> None:
    done = smoke_test(dist)
    assert "an environment resets" in done.stdout, done.stdout + done.stderr


@pytest.mark.nightly
def test_a_wheel_that_lacks_something_fails(wheel: Path, tmp_path: Path) -> None:
    poor = tmp_path / wheel.name
    with zipfile.ZipFile(wheel) as archive, zipfile.ZipFile(poor, "w") as copy:
        for name in archive.namelist():
            if not name.endswith("model_card.md"):
                copy.writestr(name, archive.read(name))
    done = smoke_test(poor, "--no-simulator")
    assert done.returncode == 1
    assert "model_card.md" in done.stderr


def smoke_test(dist: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """What a release goes through before it is published, on the packages that are here."""
    script = ROOT / "scripts" / "smoke_test_release.py"
    command = [sys.executable, str(script), str(dist), "--share-packages", *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_tag_that_is_not_the_version_and_two_wheels_publish_nothing(wheel: Path, tmp_path: Path) -> None:
    check_tag(wheel, f"v{lerobot_adamanip.__version__}")
    for tag in ("0.2.0", "v0.2", "v99.0.0", "v0.2.0-rc1"):
        with pytest.raises(ReleaseError, match="tag v"):
            check_tag(wheel, tag)
    for version in ("0.2.0", "0.3.0"):
        (tmp_path / f"lerobot_env_adamanip-{version}-py3-none-any.whl").touch()
    with pytest.raises(ReleaseError, match="one wheel wanted"):
        find_wheel(tmp_path)


def test_constraints_pin_every_dependency() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert all(line.count("==") == 1 and "@" not in line and "://" not in line for line in lines)
    pinned = {line.partition("==")[0].lower().replace("_", "-") for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *extras["sim"], *extras["docs"], *extras["dev"]]
    assert {Requirement(w).name.lower().replace("_", "-") for w in wanted} <= pinned


def test_one_version(wheel: Path) -> None:
    """The package's, which the distribution is built with; citation and changelog follow."""
    version = lerobot_adamanip.__version__
    assert wheel.name.startswith(f"lerobot_env_adamanip-{version}-")
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    entry = "Unreleased" if Version(version).is_devrelease else version
    assert f"## [{entry}]" in (ROOT / "CHANGELOG.md").read_text()


def test_scripts_are_bash() -> None:
    for script in (*(ROOT / "scripts").glob("*.sh"), ROOT / ".ci" / "run"):
        run(["bash", "-n", str(script)])
