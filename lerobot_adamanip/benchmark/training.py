"""The folder in which `lerobot-train` keeps a training: its last checkpoint, and how it goes on from there."""

from __future__ import annotations

import json
from pathlib import Path


def last_checkpoint(folder: Path | str) -> Path:
    """Returns the folder of the last weights that a training has saved, whether or not it has saved any."""
    return Path(folder) / "checkpoints" / "last" / "pretrained_model"


def trained_steps(folder: Path) -> int:
    """Returns how many steps the last checkpoint of a training has behind it; 0 if there is none."""
    state = last_checkpoint(folder).parent / "training_state" / "training_step.json"
    # LeRobot renews the link to the last checkpoint once all of that is written; between two links there is none.
    return int(json.loads(state.read_text(encoding="utf-8"))["step"]) if state.exists() else 0


def resuming(folder: Path | str, steps: int) -> list[str]:
    """Returns the command that goes on with a training until it has so many steps."""
    config = last_checkpoint(folder) / "train_config.json"
    return ["lerobot-train", f"--config_path={config}", "--resume=true", f"--steps={steps}"]
