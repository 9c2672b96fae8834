"""The scripts of `make setup` say what they install system-wide before they do, and leave it where that is asked for.

They run in a copy of the checkout where nothing renders and no package manager is real: each stand-in tells its call.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ("setup_vulkan.sh", "setup_browser.sh")
SAY = '#!/bin/bash\necho "CALLED $(basename "$0") $*"\n'
STAND_INS = {
    "apt-get": SAY,
    "apt-cache": '#!/bin/bash\necho "  Candidate: 99.0"\n',  # whatever is asked for can be had, new enough
    "dpkg": "#!/bin/bash\nexit 0\n",
    "sudo": '#!/bin/bash\n[[ $1 == -n ]] && shift\n[[ $1 == env ]] && shift 2\nexec "$@"\n',
    "tee": SAY,
    "nvidia-smi": "#!/bin/bash\nexit 1\n",
    "timeout": '#!/bin/bash\nshift\nexec "$@"\n',
    **dict.fromkeys(("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"), "#!/bin/bash\nexit 1\n"),
}


def write_commands(folder: Path, commands: dict[str, str]) -> None:
    folder.mkdir(parents=True)
    for name, text in commands.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / "scripts", tmp_path / "scripts")
    write_commands(tmp_path / "stand_ins", STAND_INS)
    # Nothing renders, and Playwright has no browser.
    write_commands(tmp_path / ".venv" / "bin", {"python": "#!/bin/bash\nexit 1\n", "playwright": SAY})
    return tmp_path


def run(checkout: Path, script: str, **variables: str) -> list[str]:
    """Returns what was said, both streams in order."""
    path = f"{checkout / 'stand_ins'}:{os.environ['PATH']}"
    environment = {k: v for k, v in os.environ.items() if k != "NO_SYSTEM"} | {"PATH": path} | variables
    command = ["bash", str(checkout / "scripts" / script)]
    done = subprocess.run(
        command, env=environment, text=True, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize("script", SCRIPTS)
def test_what_is_installed_system_wide_is_said_before_and_left_where_asked(script: str, checkout: Path) -> None:
    said = run(checkout, script)
    announced = [number for number, line in enumerate(said) if line.startswith("== installing system-wide")]
    called = [number for number, line in enumerate(said) if line.startswith("CALLED")]
    assert announced, said
    assert called, said
    assert announced[0] < called[0]
    assert "NO_SYSTEM=1" in said[announced[0]]
    said = run(checkout, script, NO_SYSTEM="1")
    assert not [line for line in said if line.startswith("CALLED")], said
    assert "apt-get" in "\n".join(said)


def test_no_system_fetches_no_python(checkout: Path) -> None:
    shutil.rmtree(checkout / ".venv")
    for name in ("python3.12", "python3", "python", "uv"):
        (checkout / "stand_ins" / name).write_text("#!/bin/bash\nexit 1\n")
        (checkout / "stand_ins" / name).chmod(0o755)
    # Only what stands in: no Python of this machine is found in its usual places either.
    variables = {"HOME": str(checkout), "PYENV_ROOT": str(checkout), "CONDA_PREFIX": str(checkout), "PYTHON": ""}
    script = checkout / "scripts" / "setup_python.sh"
    script.write_text(script.read_text().replace("/opt/python", "/nowhere").replace("/usr/local/bin", "/nowhere"))
    said = run(checkout, "setup_python.sh", NO_SYSTEM="1", **variables)
    assert not [line for line in said if line.startswith("CALLED")], said
    assert [line for line in said if "apt-get install python3.12" in line]
