"""An installed `pinocchio` does not take the place of SAPIEN's own kinematics."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.sim

OWN = "sapien.pysapien_pinocchio"
TOLD = "import sys, logging; logging.basicConfig(); "
MODULE = "from sapien.wrapper.pinocchio_model import PinocchioModel; print(PinocchioModel.__module__)"


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """Environment of a process in which there is another `pinocchio`."""
    (tmp_path / "pinocchio.py").write_text("IS_OTHER = True\n")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])}


def told(code: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-c", TOLD + code], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.parametrize(
    "name",
    [
        "lerobot_env_adamanip.fork_server_preload",
        pytest.param("lerobot_env_adamanip.sim.tasks", marks=pytest.mark.nightly),
    ],
)
def test_sapien_keeps_its_own(installed: dict[str, str], name: str) -> None:
    done = told(f"import {name}; {MODULE}; import pinocchio; print(pinocchio.IS_OTHER)", installed)
    assert done.stdout.split() == [OWN, "True"], "and who wants the other one gets it"


@pytest.mark.nightly
def test_who_came_first_is_told(installed: dict[str, str]) -> None:
    begin = "import sapien; from lerobot_env_adamanip.sim.sapien_import import import_sapien; import_sapien(); "
    done = told(begin + MODULE, installed)
    assert done.stdout.split() != [OWN], "without the guard it is replaced"
    assert "pip uninstall pin" in done.stderr
