from __future__ import annotations

import json
from pathlib import Path

import pytest

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_env_adamanip.make_environment import make_environment

pytestmark = pytest.mark.sim
SMALL = ["--category", "safe", "--objects", "safe_000,safe_003", "--episodes-per-object", "1", "--num-points", "256"]


@pytest.mark.timeout(280)
def test_safes_are_collected_and_replayed_alike(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "dataset"
    assert main(["collect", str(root), *SMALL, "--workers", "1", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["episodes"] == len(Dataset(root)) == 2
    # The second episode was recorded by a simulator that had another one behind it, and is replayed by a fresh one.
    result = replay(root, 1, make_environment, video=tmp_path / "replay.mp4")
    assert result.agrees(1e-6), result
    assert (tmp_path / "replay.mp4").stat().st_size > 0
