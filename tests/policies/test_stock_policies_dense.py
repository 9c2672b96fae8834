"""What two pages say of stock policies at control rate: their commands run as typed, without Vulkan, in fewer steps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from page_commands import FEW, SHORT, TRAINING, documented, run

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.memory import MEMORY, MEMORY_NAMES

pytestmark = [pytest.mark.sim, pytest.mark.nightly, pytest.mark.usefixtures("no_vulkan")]
UNET = ("--policy.down_dims=[16,32]", "--policy.num_inference_steps=2")
CLOUDS = ("--policy.encoder_dims=[16,16]", "--policy.encoder_out_dim=16", *UNET)
ACT = (
    "--policy.dim_model=16", "--policy.n_heads=2", "--policy.dim_feedforward=16", "--policy.n_encoder_layers=1",
    "--policy.n_vae_encoder_layers=1", "--policy.latent_dim=4",
)  # fmt: skip
POLICIES = {
    "bottles_act": ACT,
    "felt_act": ACT,
    "first_act": ACT,
    "bottles_diffusion": ("--policy.n_groups=4", *UNET),
    "felt_diffusion": ("--policy.n_groups=4", *UNET),
    "clouds_dense": CLOUDS,
    "clouds_dp3": CLOUDS,
}  # fmt: skip
"""Folder of a documented training -> the options that make its policy tiny."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the page's demonstrations are: ``outputs/bottles`` and ``outputs/clouds``."""
    return tmp_path_factory.mktemp("page")


def train(folder: Path, name: str, *changes: str) -> Path:
    """Trains as the page says, with an evaluation in the training if it has one; returns the checkpoint."""
    demos = name.partition("_")[0]
    if not (folder / "outputs" / demos).exists():
        run(documented("adamanip", f"outputs/{demos}"), folder, *FEW, *(f"--{change}" for change in changes))
    checkpoint = folder / "outputs" / name / "checkpoints" / "last" / "pretrained_model"
    if not checkpoint.exists():
        words = documented("lerobot-train", f"outputs/{name}")
        evaluates = "--env_eval_freq=0" not in words
        options = (*POLICIES[name], *TRAINING[: None if evaluates else -1], *(f"--env.{change}" for change in changes))
        assert ("pc_success" in run(words, folder, *options)) == evaluates
    return checkpoint


def trained_on_deltas(folder: Path, name: str) -> Path:
    """As `train`: the poses of an untrained policy have no rotations, and the robot refuses them."""
    (folder / "deltas").mkdir(exist_ok=True)
    return train(folder / "deltas", name, "action=ee_delta")


def test_the_first_number_is_evaluated(folder: Path) -> None:
    train(folder, "first_act")
    run(documented("lerobot-eval", "outputs/first_act"), folder, *SHORT)
    assert len((folder / "outputs" / "first_act.jsonl").read_text().splitlines()) == 1


def test_act_trains_and_is_evaluated(folder: Path) -> None:
    checkpoint = train(folder, "bottles_act")
    config = json.loads((checkpoint / "config.json").read_text())
    shapes = {name: feature["shape"] for name, feature in config["input_features"].items()}
    picture = [3, 96, 96]
    expected = {"observation.images.front": picture, "observation.images.wrist": picture, schema.STATE: [8]}
    assert shapes == expected
    run(documented("lerobot-eval", "outputs/bottles_act"), folder, *SHORT)
    (line,) = (folder / "outputs" / "bottles_act.jsonl").read_text().splitlines()
    assert json.loads(line)["split"] == "test"


@pytest.mark.parametrize("name", ["bottles_diffusion", "clouds_dense", "clouds_dp3"])
def test_other_policies_train_and_are_evaluated(folder: Path, name: str) -> None:
    assert train(folder, name).exists()


def test_a_stock_policy_is_corrected(folder: Path) -> None:
    train(folder, "bottles_act")
    run(documented("adamanip", "outputs/corrected"), folder, *FEW)
    table = pq.read_table(sorted((folder / "outputs" / "corrected" / "data").glob("*/*.parquet")))
    labels, sent = (np.array(table[key].to_pylist()) for key in (schema.ACTION, schema.EXECUTED))
    assert labels.shape[1] == 10
    assert 0.05 < (labels == sent).all(axis=1).mean() < 0.8


def test_a_policy_of_simulated_data_drives_the_twin_without_another_option(folder: Path) -> None:
    trained_on_deltas(folder, "bottles_act")
    command = documented("lerobot-rollout", "outputs/bottles_act", "docs/twin.md")
    output = run(command, folder / "deltas", "--policy.device=cpu", "--duration=2")
    assert "The rollout runs at 10 Hz" in output
    (line,) = (folder / "deltas" / "outputs" / "twin" / "act.jsonl").read_text().splitlines()
    assert json.loads(line)["object_id"].startswith("bottle")


def test_a_policy_with_a_memory_drives_the_twin(folder: Path) -> None:
    checkpoint = trained_on_deltas(folder, "felt_act")
    command = documented("lerobot-rollout", "outputs/bottles_act", "docs/twin.md")
    options = (f"--policy.path={checkpoint}", "--policy.device=cpu", "--duration=2", "--robot.memory=events")
    assert "The rollout runs at 10 Hz" in run(command, folder / "deltas", *options)


@pytest.mark.parametrize("name", ["felt_act", "felt_diffusion"])
def test_stock_policies_train_with_a_memory_and_are_evaluated_with_it_alone(folder: Path, name: str) -> None:
    checkpoint = train(folder, name)
    config = json.loads((checkpoint / "config.json").read_text())
    assert config["input_features"][MEMORY] == {"type": "ENV", "shape": [len(MEMORY_NAMES)]}
    kind = ("--env.type=adamanip_bottle", "--env.control=dense", "--env.action=ee_pose", "--env.image_size=96")
    dense = (*kind, f"--policy.path={checkpoint}")
    options = (*dense, *SHORT, f"--output_dir={folder / 'outputs' / name}_eval")
    run(["lerobot-eval"], folder, *options, "--env.memory=events")
    with pytest.raises(AssertionError, match=r"--env\.memory=events"):
        run(["lerobot-eval"], folder, *options)
