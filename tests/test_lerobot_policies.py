"""What docs/lerobot_policies.md says of LeRobot's own policies: its commands run, on data of our columns."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from doc_data import collect_fake_demos
from documents import ROOT, blocks
from page_commands import documented, run
from sound_demos import collect_sound

from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_policy_adamanip.common.cloud_to_points_step import CloudToPointsStep

PAGE = "docs/lerobot_policies.md"


@pytest.fixture
def demos(tmp_path: Path) -> Path:
    """A folder in which the page's ``outputs/demos`` are."""
    collect_fake_demos(tmp_path / "outputs" / "demos")
    return tmp_path


@pytest.mark.nightly
def test_vqbet_trains_its_codes_and_itself(demos: Path) -> None:
    words = documented("lerobot-train", "type=vqbet")
    picture = '{"type": "VISUAL", "shape": [3, 64, 64]}'
    inputs = f'{{"observation.images.front": {picture}, "observation.state": {{"type": "STATE", "shape": [24]}}}}'
    small = ("--policy.gpt_n_layer=1", "--policy.gpt_hidden_dim=32", "--policy.gpt_n_head=2", "--policy.device=cpu")
    short = ("--dataset.root=outputs/demos", "--batch_size=2", "--steps=4", "--log_freq=1", "--num_workers=0")
    said = run(words, demos, *small, *short, "--policy.n_vqvae_training_steps=2", f"--policy.input_features={inputs}")
    losses = [float(loss) for loss in re.findall(r" loss:([0-9.]+)", said)]
    assert len(losses) == 4
    assert "classification_loss" in said
    assert (demos / "outputs" / "vqbet" / "checkpoints" / "last" / "pretrained_model").exists()


def install_stand_in(folder: Path) -> Path:
    """Puts a distribution with a policy ``dp3`` into a folder, as pip would; returns the folder."""
    shutil.copytree(ROOT / "tests" / "helpers" / "stand_in_dp3", folder / "lerobot_policy_stand_in")
    told = folder / "lerobot_policy_stand_in-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: lerobot_policy_stand_in\nVersion: 1.0\n")
    return folder


def untrained(folder: Path, site: Path) -> None:
    """Runs the page's block that saves an untrained ``dp3``."""
    (block,) = (block for block in blocks("python") if block.document == PAGE and "dp3_untrained" in block.code)
    code = f"import sys; sys.path.insert(0, {str(site)!r}); import lerobot_policy_stand_in\n{block.code}"
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def trained_dp3(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder in which the page's ``dp3`` was trained some steps on a renamed cloud, and what the training said."""
    folder = tmp_path_factory.mktemp("dp3")
    (folder / "outputs").mkdir()
    collect_sound(folder / "outputs" / "demos")  # its clouds are in the workspace
    site = install_stand_in(folder / "site")
    untrained(folder, site)
    short = ("--batch_size=2", "--steps=3", "--log_freq=1", "--policy.device=cpu")
    return folder, run(documented("lerobot-train", "dp3_untrained"), folder, *short, path=site)


@pytest.mark.nightly
def test_a_policy_that_reads_what_lerobots_dp3_reads_is_trained(trained_dp3: tuple[Path, str]) -> None:
    """The cloud comes under its name, in metres, and in as many steps as the state; the checkpoint keeps the rename."""
    folder, said = trained_dp3
    farthest = [float(value) for value in re.findall(r"farthest:([0-9.]+)", said)]
    assert len(farthest) == 3
    assert all(0.3 < value <= max(DEFAULT_WORKSPACE.upper) for value in farthest), "metres, not normalised"
    checkpoint = folder / "outputs" / "dp3" / "checkpoints" / "last" / "pretrained_model"
    (rename,) = (
        step["config"]["rename_map"]
        for step in json.loads((checkpoint / "policy_preprocessor.json").read_text())["steps"]
        if "rename_map" in step.get("config", {})
    )
    assert rename == {"observation.point_cloud": "observation.pointcloud"}


@pytest.mark.parametrize("name", ["observation.point_cloud", "observation.pointcloud"])
def test_a_cloud_gets_its_shape_before_and_after_it_is_renamed(name: str) -> None:
    assert CloudToPointsStep().observation({name: torch.zeros(2, 12)})[name].shape == (2, 4, 3)


@pytest.mark.nightly
@pytest.mark.sim
def test_a_policy_that_reads_what_lerobots_dp3_reads_is_evaluated(trained_dp3: tuple[Path, str]) -> None:
    folder, _ = trained_dp3
    few = ("--eval.n_episodes=1", "--eval.batch_size=1", "--env.episode_length=3", "--policy.device=cpu")
    run(documented("lerobot-eval", "dp3"), folder, *few, path=folder / "site")
    (record,) = (folder / "outputs" / "dp3.jsonl").read_text().splitlines()
    assert json.loads(record)["key_frames"] == 3
