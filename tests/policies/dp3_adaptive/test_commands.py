"""LeRobot's own commands, in processes of their own, as a user starts them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from draccus.utils import DecodingError
from safetensors import safe_open

from lerobot_policy_adamanip import DP3AdaptiveConfig

CHECKPOINT = Path(__file__).parents[1] / "demo_checkpoint"
FAMILIES = {
    "lock": "safe", "turn to open": "door", "rotate and slide": "bottle", "push or rotate": "lamp",
    "rotation direction": "pressure_cooker", "switch and contact": "coffee_maker",
}  # fmt: skip
"""Kind of mechanism -> a category that has it."""
TINY: dict[str, object] = {
    "type": "dp3_adaptive", "num_points": 8, "encoder_dims": "[16,16]", "encoder_out_dim": 16,
}  # fmt: skip


TRAINS_TWICE = """
import sys
from lerobot.scripts.lerobot_train import main
words = sys.argv[1:]
for options in (words[: words.index("then")], words[words.index("then") + 1 :]):
    sys.argv[1:] = options
    main()
"""


def run(module: str, *options: str, timeout: float = 240) -> str:
    """Runs a command; returns what it logged."""
    return run_python("-m", module, *options, timeout=timeout)


def run_python(*words: str, timeout: float = 240) -> str:
    command = [sys.executable, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout + done.stderr


def train_options(policy: dict[str, object], dataset: Path, out: Path, *options: str) -> list[str]:
    """Returns the options with which lerobot-train trains a policy on a dataset."""
    told = [f"--policy.{name}={value}" for name, value in policy.items()]
    common = ("--policy.push_to_hub=false", "--policy.device=cpu", "--num_workers=0", "--dataset.repo_id=local/toy")
    places = (f"--dataset.root={dataset}", f"--output_dir={out}")
    return [*told, *common, *places, *options]


def averaged_steps(checkpoint: Path) -> int:
    with safe_open(checkpoint / "pretrained_model" / "model.safetensors", framework="pt") as weights:
        return int(weights.get_tensor("ema_steps"))


def test_a_training_resumes_where_it_stopped(adaptive_toy_root: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = train_options(TINY, adaptive_toy_root, out, "--batch_size=2", "--steps=4", "--save_freq=4")
    first, second = out / "checkpoints" / "000004", out / "checkpoints" / "000006"
    config = first / "pretrained_model" / "train_config.json"
    log = run_python(
        "-c", TRAINS_TWICE, *options, "then", f"--config_path={config}", "--resume=true", "--steps=6", "--save_freq=6"
    )
    assert (averaged_steps(first), averaged_steps(second)) == (4, 6)
    assert "Resuming data order" in log
    saved = json.loads((second / "pretrained_model" / "config.json").read_text())
    assert (saved["type"], saved["num_points"]) == ("dp3_adaptive", 8)
    assert (second / "pretrained_model" / "policy_preprocessor.json").is_file()


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("category", FAMILIES.values(), ids=FAMILIES)
def test_what_was_shown_is_opened(category: str, tmp_path: Path) -> None:
    """One object in one place, so that what is hidden is all that differs: demonstrations of every hidden state."""
    demos, out, log = tmp_path / "demos", tmp_path / "train", tmp_path / "log.jsonl"
    run(
        *("lerobot_adamanip.cli.main", "collect", str(demos), "--category", category, "--objects", "0:1"),
        *("--poses", "fixed", "--late-starts", "0", "--episodes-per-object", "12", "--repo-id", "local/toy"),
        timeout=1500,
    )
    environment = (f"--env.type=adamanip_{category}", "--env.objects=0:1", "--env.poses=fixed")
    steps = ("--batch_size=64", "--steps=700", "--save_freq=700", "--env_eval_freq=0")
    options = train_options({"type": "dp3_adaptive"}, demos, out, *environment, *steps)
    run("lerobot.scripts.lerobot_train", *options, timeout=1500)
    run(
        *("lerobot.scripts.lerobot_eval", f"--policy.path={out}/checkpoints/last/pretrained_model"),
        *("--policy.device=cpu", *environment, f"--env.episode_log={log}", "--eval.n_episodes=10"),
        *("--eval.batch_size=1", f"--output_dir={tmp_path / 'eval'}"),
        timeout=1500,
    )
    episodes = [json.loads(line) for line in log.read_text().splitlines()][:10]
    opened = sum(episode["success"] for episode in episodes)
    assert opened >= 8, [(episode["hidden_state"], episode["success"]) for episode in episodes]


@pytest.mark.sim
def test_published_weights_still_open_safes(tmp_path: Path) -> None:
    """An upgrade that changes what saved weights do is seen here; how they were made: demo_checkpoint/README.md."""
    log = tmp_path / "log.jsonl"
    run(
        *("lerobot.scripts.lerobot_eval", f"--policy.path={CHECKPOINT}", "--policy.device=cpu"),
        *("--env.type=adamanip_safe", "--env.objects=0:4", "--env.split=validation", "--env.observe_images=false"),
        *(f"--env.episode_log={log}", "--eval.n_episodes=5", "--eval.batch_size=1", "--eval.use_async_envs=false"),
        f"--output_dir={tmp_path / 'eval'}",
    )
    episodes = [json.loads(line) for line in log.read_text().splitlines()]
    assert len(episodes) == 5
    assert sum(episode["success"] for episode in episodes) >= 4
    assert any(fails for episode in episodes for *_, fails in episode["try_sequence"])


def test_a_checkpoint_of_another_version_is_refused(tmp_path: Path) -> None:
    saved = json.loads((CHECKPOINT / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**saved, "tcp_relative": True, "kernel_size": None}))
    with pytest.raises(DecodingError, match="fields `tcp_relative`, `kernel_size` are not valid for DP3AdaptiveConfig"):
        DP3AdaptiveConfig.from_pretrained(tmp_path)
