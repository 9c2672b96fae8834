"""README and tutorial on a machine without a Vulkan device: their commands in order, at the smallest size."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from documents import commands

SMALLEST = {
    "adamanip collect": {"--objects": "0:1", "--episodes-per-object": "1", "--late-starts": "0", "--workers": "1"},
    "lerobot-train": {
        "--steps": "2", "--batch_size": "2", "--num_workers": "0", "--save_freq": "2", "--policy.device": "cpu",
        "--env_eval_freq": "0",
    },
    "lerobot-eval": {"--eval.n_episodes": "1", "--eval.batch_size": "1", "--env.episode_length": "2"},
}  # fmt: skip
"""Options of commands, instead of what the documents say."""
ELSEWHERE = ("USER/", "--policy.preset=paper", "--resume=true")
"""Words of commands that need the Hub, a GPU or more steps; what other tests run."""
PICTURES = ("VISUAL", "adamanip objects", "outputs/act/")
"""Words of commands that need pictures, and of those that come after them."""
AFTER_TRAINING = "outputs/corrections"
"""The tutorial tells of corrections, which need a trained policy, before it trains one."""
ADDED = {
    "--env.type=adamanip": ("--env.categories=safe",),
    "--policy.type=act": ("--policy.pretrained_backbone_weights=null",),
}
"""Word of a command -> options after it: nine simulators, one after the other, take minutes; weights need a network."""


def smallest(words: list[str]) -> list[str]:
    """The command at its smallest size."""
    ours = words[0] == "adamanip"
    changed = SMALLEST.get(" ".join(words[: 1 + ours]), {})
    kept, skip = [], False
    for word in words:
        key, _, value = word.partition("=")
        if not skip and key not in changed:
            kept += [word, *ADDED.get(word, ())]
        skip = key in changed and not value
    pairs = [list(pair) if ours else ["=".join(pair)] for pair in changed.items()]
    return [*kept, *(word for pair in pairs for word in pair)]


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    modules = {"adamanip": "lerobot_adamanip.cli.main"}
    module = modules.get(words[0]) or f"lerobot.scripts.{words[0].replace('-', '_')}"
    return subprocess.run(
        [sys.executable, "-m", module, *words[1:]], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.usefixtures("no_vulkan")
@pytest.mark.parametrize("document", ["README.md", "docs/tutorial.md"])
def test_the_commands_of_a_document_run_without_a_vulkan_device(document: str, tmp_path: Path) -> None:
    ran = 0
    (tmp_path / "outputs").mkdir()
    lines = [each.values[0] for each in commands(("adamanip", "lerobot-train", "lerobot-eval"), document)]
    for words in sorted(lines, key=lambda words: AFTER_TRAINING in " ".join(words)):
        line = " ".join(words)
        if words[:2] == ["adamanip", "doctor"] or any(word in line for word in ELSEWHERE):
            continue
        if words[:2] == ["adamanip", "objects"]:
            done = run(words, tmp_path)
            assert done.returncode == 2
            assert re.match(r"error: .*\n  got:.*\n  allowed:.*\n  try:", done.stderr[done.stderr.index("error: ") :])
        elif not any(word in line for word in PICTURES):
            done = run(smallest(words), tmp_path)
            assert done.returncode == 0, f"{line}\n{done.stdout[-3000:]}\n{done.stderr[-6000:]}"
            ran += 1
    assert ran > 3
