"""A policy trains on a mix of a robot's recordings and simulated demonstrations, by LeRobot's own command."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from demos_helpers import fakes, make_spec, patiently
from dense_helpers import dense_episode, write_recording

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.recordings.convert import convert

STEPS = 300
OPTIONS = (
    "--policy.type=dp3_adaptive", "--policy.preset=diffusion", "--policy.num_points=8", "--policy.encoder_dims=[16,16]",
    "--policy.encoder_out_dim=16", "--policy.down_dims=[32,64]", "--policy.diffusion_step_embed_dim=16",
    "--policy.push_to_hub=false", "--policy.device=cpu", "--batch_size=8", "--num_workers=0",
    f"--steps={STEPS}", f"--save_freq={STEPS}", "--log_freq=20", "--env_eval_freq=0",
)  # fmt: skip


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_the_loss_on_a_mix_falls_by_half(tmp_path: Path) -> None:
    collect(tmp_path / "simulated", make_spec(), fakes(), patiently())
    recording = write_recording(tmp_path / "recording", dense_episode(seed=1), dense_episode(seed=2))
    made = convert([recording, tmp_path / "simulated"], tmp_path / "mix")
    assert made.episodes == 2
    assert made.simulated > 0
    own = (
        "--dataset.repo_id=local/mix",
        f"--dataset.root={tmp_path / 'mix'}",
        f"--output_dir={tmp_path / 'run'}",
        *OPTIONS,
    )
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_train", *own]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    losses = [float(value) for value in re.findall(r"loss:([0-9.]+)", done.stdout + done.stderr)]
    assert len(losses) == STEPS // 20
    assert np.mean(losses[-3:]) <= 0.5 * losses[0], losses
