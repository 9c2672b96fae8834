"""LeRobot's own training command, in processes of its own, as a user starts it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from safetensors import safe_open

DP3 = (
    "--policy.type=dp3_adaptive",
    "--policy.preset=diffusion",
    "--policy.num_points=32",
    "--policy.encoder_dims=[16,16]",
    "--policy.encoder_out_dim=16",
    "--policy.down_dims=[32,64]",
    "--policy.diffusion_step_embed_dim=16",
)
ACT = (
    "--policy.type=act",
    "--policy.pretrained_backbone_weights=null",
    "--policy.chunk_size=4",
    "--policy.n_action_steps=2",
    "--policy.dim_model=16",
    "--policy.n_heads=2",
    "--policy.dim_feedforward=16",
    "--policy.n_encoder_layers=1",
    "--policy.n_vae_encoder_layers=1",
    "--policy.latent_dim=4",
)
COMMON = (
    "--policy.push_to_hub=false",
    "--policy.device=cpu",
    "--batch_size=2",
    "--num_workers=0",
)


def _train(*options: str) -> str:
    """Runs lerobot-train; returns what it logged."""
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_train", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout + done.stderr


def _dataset(root: Path) -> tuple[str, ...]:
    return ("--dataset.repo_id=local/tiny", f"--dataset.root={root}", *COMMON)


def _averaged_steps(checkpoint: Path) -> int:
    with safe_open(checkpoint / "pretrained_model" / "model.safetensors", framework="pt") as weights:
        return int(weights.get_tensor("ema_steps"))


def test_a_training_resumes_where_it_stopped(dataset_root: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    _train(*DP3, *_dataset(dataset_root), "--steps=4", "--save_freq=4", "--log_freq=1", f"--output_dir={run}")
    first = run / "checkpoints" / "000004"
    assert _averaged_steps(first) == 4
    config = first / "pretrained_model" / "train_config.json"
    log = _train(f"--config_path={config}", "--resume=true", "--steps=6", "--save_freq=6")
    second = run / "checkpoints" / "000006"
    assert _averaged_steps(second) == 6
    assert "Resuming data order" in log
    saved = json.loads((second / "pretrained_model" / "config.json").read_text())
    assert saved["type"] == "dp3_adaptive"
    assert saved["num_points"] == 32
    assert (second / "pretrained_model" / "policy_preprocessor.json").is_file()


@pytest.mark.nightly
def test_act_trains_on_the_same_dataset(dataset_root: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    _train(*ACT, *_dataset(dataset_root), "--steps=2", "--save_freq=2", f"--output_dir={run}")
    assert (run / "checkpoints" / "000002" / "pretrained_model" / "model.safetensors").is_file()
