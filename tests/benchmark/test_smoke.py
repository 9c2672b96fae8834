"""The smallest scale of the paper's table, run whole: every method collects, learns and is tested, by one command."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lerobot_adamanip.benchmark.declaration import read_declaration

SCALE = "smoke"


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_every_method_learns_and_is_tested(tmp_path: Path) -> None:
    command = [str(Path(sys.executable).with_name("adamanip")), "benchmark", "--scale", SCALE, "--jobs", "2", "--json"]
    done = subprocess.run([*command, "--out", str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    cells = json.loads(done.stdout)["cells"]
    declaration = read_declaration()
    assert {cell["state"] for cell in cells} == {"done"}
    assert {cell["method"] for cell in cells} == set(declaration.methods)
    episodes = declaration.scale(SCALE).episodes
    assert {cell["success"]["episodes"] for cell in cells} == {episodes}
    trainings = sorted((tmp_path / SCALE / "steps").glob("train-*.log"))
    assert len(trainings) == len(cells), "no two methods learn the same"
    for log in trainings:
        losses = [float(value) for value in re.findall(r" loss:([0-9.]+)", log.read_text(errors="replace"))]
        assert len(losses) >= 10, log.name
        assert np.mean(losses[-3:]) < 0.9 * losses[0], f"{log.name}: {losses}"
    table = (tmp_path / SCALE / "report" / "benchmark.md").read_text()
    assert all(method.title in table for method in declaration.methods.values())
