from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from demos_helpers import ATTEMPTS, HERE, fakes

from lerobot_adamanip.cli import collect as command
from lerobot_adamanip.cli.collect_setup import resolve_images
from lerobot_adamanip.cli.main import main, parse_command
from lerobot_adamanip.collection.collect import CollectOptions
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.manifest import read_manifest
from lerobot_env_adamanip.sim import render_device

SMALL = ["--objects", "0:2", "--episodes-per-object", "2", "--num-points", "8", "--late-starts", "0.5",
          "--max-attempts", str(ATTEMPTS)]  # fmt: skip

# Tests may run in the background of a shell, where processes start with SIGINT ignored; a terminal's do not.
SCRIPT = """
import signal, sys
sys.path.insert(0, sys.argv.pop(1))
from demos_helpers import fakes
from lerobot_adamanip.cli import collect as command
from lerobot_adamanip.cli.main import main
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    command.factories = lambda: fakes(delay=0.1)
    sys.exit(main())
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, in_process: None) -> None:
    monkeypatch.setattr(command, "factories", fakes)


@pytest.mark.usefixtures("fake")
def test_it_prints_one_json_object_with_the_figures(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "dataset"
    assert main(["collect", str(root), *SMALL, "--json"]) == 0
    output, progress = capfd.readouterr()
    content: dict[str, Any] = json.loads(output)
    assert "recorded in all: 4/4 (100 %)" in progress  # no terminal: a line now and then
    assert "writing the dataset: 4/4" in progress
    attempts = Dataset(root).table["attempts"].to_pylist()
    assert content["episodes"] == content["recorded"] == len(attempts) == 4
    assert content["attempts"] == content["attempted"] == sum(attempts)
    assert content["success_rate"] == pytest.approx(4 / sum(attempts))
    assert content["episodes_per_minute"] == pytest.approx(240 / content["recording_seconds"], rel=1e-3)
    assert content["bytes"] == sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
    assert main(["collect", str(root), *SMALL]) == 0
    assert f"Complete: 4 episodes in {root}, none of them recorded by this run." in capfd.readouterr().out


@pytest.mark.usefixtures("fake")
def test_poses_are_left_unscaled_on_request_and_the_rows_stay(tmp_path: Path) -> None:
    roots = [tmp_path / "measured", tmp_path / "unscaled"]
    (tmp_path / "unscaled-failed").mkdir()  # of something else: without --keep-failed it is left alone
    (tmp_path / "unscaled-failed" / "note.txt").write_text("mine")
    for root, words in zip(roots, ([], ["--unscaled-poses"]), strict=True):
        assert main(["collect", str(root), *SMALL, *words]) == 0
    statistics = [json.loads((root / "meta" / "stats.json").read_text())["action"] for root in roots]
    assert statistics[1]["mean"][3:] == [0.0] * 7
    assert statistics[1]["std"][3:] == [1.0] * 7
    assert statistics[0]["mean"][:3] == statistics[1]["mean"][:3]
    assert statistics[0]["std"][3:] != statistics[1]["std"][3:]
    rows = [dataset.columns(dataset.episode(0))["action"].tobytes() for dataset in map(Dataset, roots)]
    assert rows[0] == rows[1]


@pytest.mark.usefixtures("fake")
def test_ctrl_c_stops_cleanly_and_says_how_to_resume(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "dataset"
    script = tmp_path / "adamanip"
    script.write_text(SCRIPT)
    line = ["collect", str(root), *SMALL, "--workers", "2"]
    command_line = [sys.executable, str(script), HERE, *line]
    process = subprocess.Popen(command_line, start_new_session=True, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 200
    while not list(CollectionPaths(root).episodes.glob("*.safetensors")):
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to parent and workers alike
    _, message = process.communicate(timeout=30)
    assert process.returncode == 130
    assert f"adamanip collect {root}" in message
    assert "Traceback" not in message
    kept = len(list(CollectionPaths(root).episodes.glob("*.safetensors")))
    assert main([*line, "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["recorded"] == 4 - kept < 4


def test_options_that_do_not_change_the_data_reach_the_collection(tmp_path: Path) -> None:
    line = [str(tmp_path / "d"), "--worker-timeout", "5", "--max-attempts", "3", "--workers", "2", "--allow-missing"]
    expected = CollectOptions(workers=2, worker_timeout=5.0, max_attempts=3, allow_missing=True)
    assert parse_command("collect", line).options() == expected


@pytest.mark.parametrize("renders", [True, False])
@pytest.mark.usefixtures("fake")
def test_pictures_are_taken_where_something_renders_and_a_collection_keeps_its_choice(
    renders: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(render_device, "can_render", lambda: renders)
    root = tmp_path / "dataset"
    line = ["collect", str(root), *SMALL]
    assert main(line) == 0
    printed = capfd.readouterr().err.splitlines()
    said = [line for line in printed if "No pictures" in line]
    assert len(said) == 2 * (not renders), "at the top, and again at the end"
    assert renders or printed[-1] == said[-1]
    assert all("setup_vulkan.sh" in each for each in said)
    has = read_manifest(CollectionPaths(root).manifest).spec.environment.observe_images
    assert has is renders
    monkeypatch.setattr(render_device, "can_render", lambda: not renders)
    assert main(line) == 0
    assert "Complete: 4 episodes" in capfd.readouterr().out
    assert resolve_images((tmp_path / "new", root), False) is renders, "a part's choice is that of the whole"


@pytest.mark.usefixtures("fake")
def test_pictures_that_are_wanted_and_cannot_be_taken_are_an_error_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(render_device, "can_render", lambda: False)
    for more, said in (
        (["--image-size", "64"], "no Vulkan device"),
        (["--image-size", "1"], "16 ... 2048"),
    ):
        assert main(["collect", str(tmp_path / "dataset"), *SMALL, *more]) == 2
        assert said in capfd.readouterr().err
    monkeypatch.setattr(
        render_device, "can_render", lambda: pytest.fail("a typo is told before a renderer is looked for")
    )
    assert main(["collect", str(tmp_path / "dataset"), *SMALL, "--late-starts", "2"]) == 2
    assert main(["collect", str(tmp_path / "dataset"), *SMALL, "--workers", "0"]) == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("fake")
def test_other_options_are_refused_before_a_simulator_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "dataset"
    line = ["collect", str(root), *SMALL, "--no-images"]
    assert main([*line, "--part", "1/2"]) == 0
    partial = CollectionPaths(root).partial
    for folder in (partial, root):
        monkeypatch.setattr(command, "factories", lambda: pytest.fail("a simulator is made"))
        capfd.readouterr()
        assert main([*line, "--seed", "5"]) == 2
        said = capfd.readouterr().err
        assert f"{folder} holds a collection made with other options: seed differ" in said
        assert "starting" not in said
        monkeypatch.setattr(command, "factories", fakes)
        assert main(line) == 0
