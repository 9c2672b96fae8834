"""A policy that is shown a few scenes opens them: from collection to evaluation, for each kind of mechanism."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.sim, pytest.mark.nightly, pytest.mark.timeout(1800)]
FAMILIES = {
    "lock": "safe", "turn to open": "door", "rotate and slide": "bottle", "push or rotate": "lamp",
    "rotation direction": "pressure_cooker", "switch and contact": "coffee_maker",
}  # fmt: skip
"""Kind of mechanism -> a category that has it."""
EPISODES, STEPS = 12, 700


def _run(*command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, timeout=1500, check=False)
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.parametrize("category", FAMILIES.values(), ids=FAMILIES)
def test_what_was_shown_is_opened(category: str, tmp_path: Path) -> None:
    """One object in one place, so that what is hidden is all that differs: demonstrations of every hidden state."""
    demos, train, log = tmp_path / "demos", tmp_path / "train", tmp_path / "log.jsonl"
    scene = ("--objects", "0:1", "--poses", "fixed")
    _run(
        *("lerobot_adamanip.cli.main", "collect", str(demos), "--category", category, *scene, "--late-starts", "0"),
        *("--episodes-per-object", str(EPISODES), "--repo-id", "local/overfit"),
    )
    environment = (f"--env.type=adamanip_{category}", "--env.objects=0:1", "--env.poses=fixed")
    _run(
        *("lerobot.scripts.lerobot_train", "--policy.type=dp3_adaptive", "--policy.device=cpu", *environment),
        *("--policy.push_to_hub=false", "--env_eval_freq=0", f"--steps={STEPS}", f"--save_freq={STEPS}"),
        *("--dataset.repo_id=local/overfit", f"--dataset.root={demos}", "--batch_size=64", "--num_workers=0"),
        f"--output_dir={train}",
    )
    _run(
        *("lerobot.scripts.lerobot_eval", f"--policy.path={train}/checkpoints/last/pretrained_model"),
        *("--policy.device=cpu", *environment, f"--env.episode_log={log}", "--eval.n_episodes=10"),
        *("--eval.batch_size=1", f"--output_dir={tmp_path / 'eval'}"),
    )
    episodes = [json.loads(line) for line in log.read_text().splitlines()][:10]
    opened = sum(episode["success"] for episode in episodes)
    assert opened >= 8, [(episode["hidden_state"], episode["success"]) for episode in episodes]
