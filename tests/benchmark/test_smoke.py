"""The smallest scale of the paper's table, run by one command: methods learn, two open what they learnt."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from lerobot_adamanip.benchmark.declaration import PAPER_TABLE, read_declaration

SCALE = "smoke"
UNSURE = ("sampling", "act", "dp3", "dp3_on_adaptive", "adaafford", "dp3_adaptive_on_static")
"""What one draws is chance; the others would take more steps than there is time for, and open little or nothing."""

TRAINED = (
    "sampling", "vat_mart", "adaafford", "act", "dp3", "dp3_on_adaptive", "dp3_adaptive_on_static", "dp3_adaptive",
)  # fmt: skip
"""Left out: other settings of these, and what is not trained."""

SHORT = {
    "steps = { smoke = 800 }": "steps = { smoke = 60 }", "demonstrations = 8\n": "demonstrations = 4\n",
    "episodes = 4\n": "episodes = 1\n", "--env.episode_length=24": "--env.episode_length=8",
}  # fmt: skip
"""The scale by day: the loss falls, what is opened is chance. By day a saved checkpoint opens safes instead."""


def test_what_trains_by_night_is_declared() -> None:
    assert set(TRAINED) <= read_declaration(PAPER_TABLE).methods.keys()


@pytest.mark.sim
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("methods", "options", "learns"),
    [
        pytest.param(["dp3_adaptive"], ["--categories=safe"], False, id="one method and category"),
        pytest.param(
            list(TRAINED),
            ["--jobs=2"],
            True,
            id="every method",
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_a_method_learns_and_is_tested(methods: list[str], options: list[str], learns: bool, tmp_path: Path) -> None:
    """`dp3_adaptive` and VAT-Mart, whose one plan is right half of the time, open some of what they learnt by heart."""
    config, text = tmp_path / "declaration.toml", PAPER_TABLE.read_text()
    for long, short in SHORT.items():
        assert long in text
        text = text if learns else text.replace(long, short, 1)
    config.write_text(text)
    declaration = read_declaration(config)
    command = [str(Path(sys.executable).with_name("adamanip")), "benchmark", "--scale", SCALE, "--json", *options]
    command += ["--methods", ",".join(methods), "--out", str(tmp_path), "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    cells = json.loads(done.stdout)["cells"]
    assert {cell["state"] for cell in cells} == {"done"}
    assert {cell["method"] for cell in cells} == set(methods)
    scale = declaration.scale(SCALE)
    assert {cell["success"]["episodes"] for cell in cells} == {scale.episodes}
    trainings = sorted((tmp_path / SCALE / "steps").glob("train-*.log"))
    assert len(trainings) == len(cells), "no two methods learn the same"
    for log in trainings:
        losses = [float(value) for value in re.findall(r" loss:([0-9.]+)", log.read_text(errors="replace"))]
        assert len(losses) >= 10, log.name
        assert np.mean(losses[-3:]) < 0.9 * losses[0], f"{log.name}: {losses}"
    opened: Counter[str] = Counter()
    for cell in cells:
        opened[cell["method"]] += cell["success"]["count"]
    few = {method: count for method, count in opened.items() if count == 0 and method not in UNSURE}
    assert not (few and learns), f"nothing opened by {few}: {opened}"
    table = (tmp_path / SCALE / "report" / "benchmark.md").read_text()
    assert all(declaration.methods[name].title in table for name in methods)
