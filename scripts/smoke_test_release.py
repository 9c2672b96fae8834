"""Installs a built wheel into a new environment and tests it: `python scripts/smoke_test_release.py dist`.

The test does not see the checkout: it runs in another folder without PYTHONPATH. --share-packages uses the dependencies
of the running Python and downloads nothing. Without it, pip downloads them, as for a user of the release. Exit status 0
on success, 1 on failure.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
import venv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FACTS = """
import importlib.util, json
import lerobot_adamanip, lerobot_env_adamanip, lerobot_policy_adamanip
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_adamanip.benchmark.declaration import read_declaration
from lerobot_adamanip.datasets.cards import card_template
read_declaration()
card_template("dataset_card.md"), card_template("model_card.md")
register_third_party_plugins()
modules = (lerobot_adamanip, lerobot_env_adamanip, lerobot_policy_adamanip)
print(json.dumps({
    "version": lerobot_adamanip.__version__,
    "files": [module.__file__ for module in modules],
    "types": [*EnvConfig.get_known_choices(), *PreTrainedConfig.get_known_choices()],
    "simulates": all(importlib.util.find_spec(name) for name in ("sapien", "mani_skill")),
}))
"""
RESET = """
import json
from lerobot_adamanip.contract.schema import STATE_DIM
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
env = KeyframeEnv("safe", objects="0:4", observe_images=False)
observation, info = env.reset(seed=5)
env.close()
print(json.dumps({"state": observation["agent_pos"].shape == (STATE_DIM,), "success": info["is_success"]}))
"""
TYPES = {"adamanip", "adamanip_safe", "adamanip_lamp", "dp3_adaptive", "vat_mart", "adaafford", "sampling"}
SIMULATOR = {"mani-skill", "sapien", "opencv-python", "cv2", "Ray-cast clouds"}
"""Checks of `adamanip doctor` that fail without the extra `sim`."""


class ReleaseError(Exception):
    """The release fails a check."""


def main() -> int:
    """Runs all checks and prints the passed ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dist", type=Path, help="folder with one wheel and one source archive, or the wheel itself")
    parser.add_argument("--share-packages", action="store_true", help="use this Python's packages, download nothing")
    parser.add_argument("--extras", default="", help="extras to install, e.g. `sim,assets`")
    parser.add_argument("--constraints", type=Path, help="constraints file for pip")
    parser.add_argument("--tag", help="git tag, which must be v and the version; empty for none")
    parser.add_argument("--no-simulator", action="store_true", help="skip checks that render or simulate")
    options = parser.parse_args()
    try:
        wheel = find_wheel(options.dist)
        check_tag(wheel, options.tag)
        with tempfile.TemporaryDirectory(prefix="adamanip-release-") as folder:
            python = make_environment(Path(folder) / "venv", wheel, options)
            for name in try_release(python, wheel, Path(folder), simulator=not options.no_simulator):
                sys.stdout.write(f"ok    {name}\n")
                sys.stdout.flush()
    except ReleaseError as error:
        sys.stderr.write(f"FAIL  {error}\n")
        return 1
    return 0


def find_wheel(dist: Path) -> Path:
    """Returns the only wheel in a folder. Raises `ReleaseError` for none or several."""
    wheels = [dist] if dist.suffix == ".whl" else sorted(dist.glob("*.whl"))
    if len(wheels) != 1:
        raise ReleaseError(f"{dist}: one wheel wanted, found {[wheel.name for wheel in wheels]}")
    return wheels[0]


def version_of(wheel: Path) -> str:
    """Returns the version in a wheel's file name."""
    return wheel.name.split("-")[1]


def check_tag(wheel: Path, tag: str | None) -> None:
    """Raises `ReleaseError` for a tag that is not v and the wheel's version."""
    if tag and tag != f"v{version_of(wheel)}":
        raise ReleaseError(f"tag {tag!r}, but the version is {version_of(wheel)}: tag v{version_of(wheel)}")


def make_environment(folder: Path, wheel: Path, options: argparse.Namespace) -> Path:
    """Creates a new environment with the wheel and returns its Python."""
    if options.share_packages:
        return share_packages(folder, wheel)
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    requirement = f"{wheel.resolve()}[{options.extras}]" if options.extras else str(wheel.resolve())
    pinned = ["-c", str(options.constraints.resolve())] if options.constraints else []
    run([str(python), "-m", "pip", "install", "--quiet", "--no-input", requirement, *pinned], folder)
    return python


def share_packages(folder: Path, wheel: Path) -> Path:
    """Creates a new environment with the wheel and links to this one's packages. Returns its Python.

    It links each package instead of the whole folder in a .pth file. The folder may contain an editable installation of
    a checkout, and the test would then run the sources instead of the wheel.
    """
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    site = Path(run([str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder).strip())
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", "--quiet"]
    run([*pip, str(wheel.resolve())], folder)
    for package in Path(sysconfig.get_path("purelib")).iterdir():
        if "adamanip" not in package.name and not (site / package.name).exists():
            (site / package.name).symlink_to(package)
    return python


def try_release(python: Path, wheel: Path, folder: Path, *, simulator: bool) -> Iterator[str]:
    """Yields the name of each passed check. Raises `ReleaseError` at the first failure."""
    version, command = version_of(wheel), str(python.parent / "adamanip")
    facts = answer(python, FACTS, folder)
    outside = [file for file in facts["files"] if not Path(file).is_relative_to(python.parents[1])]
    expect(not outside, f"imported from outside the new environment: {outside}")
    expect(facts["version"] == version, f"the package says {facts['version']}, the wheel {version}")
    expect(run([command, "--version"], folder).split()[-1] == version, "adamanip --version differs")
    yield f"the packages, their files and the command are those of {version}"
    listed = set(re.findall(r"^  (\w+)", run([command, "--help"], folder), re.MULTILINE))
    expect({"collect", "doctor", "report"} <= listed, f"adamanip --help lists {sorted(listed)}")
    yield f"adamanip --help lists {len(listed)} commands"
    expect(set(facts["types"]) >= TYPES, f"LeRobot does not know {sorted(TYPES - set(facts['types']))}")
    yield "LeRobot finds the environments and the policies"
    if simulator:
        yield from try_simulator(python, folder, simulates=facts["simulates"])


def try_simulator(python: Path, folder: Path, *, simulates: bool) -> Iterator[str]:
    """Yields the name of each passed check of the simulator, or a text that it is not installed."""
    report = json.loads(run([str(python.parent / "adamanip"), "doctor", "--json"], folder, statuses=(0, 1)))
    failed = {check["name"] for check in report["checks"] if check["required"] and not check["ok"]}
    expect(not failed - (set() if simulates else SIMULATOR), f"adamanip doctor: {sorted(failed)}")
    yield f"adamanip doctor, simulator {'there' if simulates else 'not installed'}"
    if simulates:
        expect(answer(python, RESET, folder) == {"state": True, "success": False}, "a reset safe is no safe")
        yield "an environment resets"


def expect(holds: bool, otherwise: str) -> None:
    """Raises `ReleaseError` with the text ``otherwise`` if ``holds`` is False."""
    if not holds:
        raise ReleaseError(otherwise)


def answer(python: Path, code: str, folder: Path) -> Any:
    """Returns the JSON value on the last line of a program's output."""
    return json.loads(run([str(python), "-c", code], folder).strip().splitlines()[-1])


def run(command: list[str], folder: Path, *, statuses: tuple[int, ...] = (0,)) -> str:
    """Runs a program in a folder outside the checkout and returns its output. Raises `ReleaseError` on failure."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, cwd=folder.parent, env=variables, capture_output=True, text=True, check=False)
    if done.returncode not in statuses:
        raise ReleaseError(f"{' '.join(command)}: exit status {done.returncode}\n{done.stdout}\n{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
