"""Commands of the pages about stock policies, run as a user types them, in fewer steps."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from documents import ROOT, commands

PAGES = ("docs/lerobot_policies.md", "docs/memory.md")
MODULES = {
    "adamanip": "lerobot_adamanip.cli.main",
    "lerobot-train": "lerobot.scripts.lerobot_train",
    "lerobot-eval": "lerobot.scripts.lerobot_eval",
    "lerobot-rollout": "lerobot.scripts.lerobot_rollout",
}
FEW = ("--workers=1", "--episodes-per-object=1", "--objects=0:2")
SHORT = ("--policy.device=cpu", "--env.episode_length=12", "--eval.n_episodes=1", "--eval.batch_size=1")
TRAINING = (*SHORT, "--batch_size=2", "--steps=2", "--log_freq=1", "--num_workers=0", "--env_eval_freq=2")


def documented(program: str, mark: str, *pages: str) -> list[str]:
    """The command of a program that says ``mark``, on the first of `PAGES` or of other pages that has one."""
    for page in pages or PAGES:
        known = [param.values[0] for param in commands(program) if param.id.startswith(page)]
        if said := [words for words in known if any(re.search(rf"{mark}(?!\w)", word) for word in words)]:
            (words,) = said
            return words
    raise AssertionError(f"no {program} of {mark}")


def run(words: list[str], folder: Path, *changes: str, path: Path | None = None) -> str:
    """Runs a command with some of its options changed, as a user starts it; returns its output.

    ``path`` is a folder of further packages.
    """
    names = {change.partition("=")[0] for change in changes}
    kept, skips = [], False
    for word in words[1:]:  # options of adamanip have their value in the next word
        if skips and not word.startswith("--"):
            continue
        skips = word in names
        kept += [] if word.partition("=")[0] in names else [word]
    folders = [path or "", ROOT, ROOT / "envs", ROOT / "policies", os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-m", MODULES[words[0]], *kept, *changes],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, map(str, folders))), "HF_HUB_OFFLINE": "1"},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout + done.stderr
