"""What a recording of the twin is good for, for check_twin_session.py: key frames, their replay, a mixed training."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.contract import schema
from lerobot_adamanip.hardware.features import SCALAR_NAMES, SENT_NAMES
from lerobot_adamanip.util.json_fields import read
from lerobot_policy_adamanip.common.recorded_rows import read_columns

STEPS = 300
"""Of the mixed training."""
SHARE_REPLAYED = 0.8
"""Of the converted episodes whose key frames have to open the door again."""
Run = Callable[..., Path]
"""(program, arguments...) -> log of what it said; raises RuntimeError if it failed."""


def convert(run: Run, recorded: Path, simulated: Path, converted: Path) -> None:
    """Makes key frames of a recording, and records a few simulated episodes to compare and to mix them with."""
    run("adamanip", "keyframes", str(recorded), "--out", str(converted))
    run(
        "adamanip",
        "collect",
        str(simulated),
        "--category",
        "microwave",
        "--objects",
        "0:2",
        "--episodes-per-object",
        "2",
    )


def same_description(simulated: Path, converted: Path) -> bool:
    """Whether both ``meta/info.json`` are equal but for counts, and for the camera's intrinsics."""

    def told(root: Path) -> dict[str, Any]:
        info = read(root / "meta" / "info.json")
        info["features"][schema.FRONT_IMAGE]["info"].pop("intrinsics", None)
        return {key: value for key, value in info.items() if not key.startswith("total_") and key != "splits"}

    return told(simulated) == told(converted)


def rows_of(root: Path, *columns: str) -> dict[str, Any]:
    """Returns columns of all rows, in order."""
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

    return read_columns(LeRobotDatasetMetadata(f"local/{root.name}", root=root), columns)


def accepted_targets(recorded: Path, converted: Path) -> bool:
    """Whether each key frame's action is, in float32, a target that the arm had accepted in its episode."""
    dense = rows_of(recorded, schema.STATE, "episode_index")
    sent = dense[schema.STATE][:, [SCALAR_NAMES.index(name) for name in SENT_NAMES]].astype(np.float32)
    made = rows_of(converted, schema.ACTION, schema.DONE, "episode_index")
    origin = [recorded_episode(row) for row in episodes_of(converted)]
    for action, done, episode in zip(*made.values(), strict=True):
        accepted = sent[dense["episode_index"] == origin[int(episode)]]
        pose = np.asarray(action, np.float32)[: schema.GRIPPER_DIM]
        if not done and not (accepted[:, : schema.GRIPPER_DIM] == pose).all(axis=1).any():
            return False
    return True


def episodes_of(root: Path) -> list[dict[str, Any]]:
    """Returns the rows of ``meta/episodes`` that tell where episodes come from."""
    import pyarrow.dataset as pads

    files = [str(path) for path in sorted((root / "meta" / "episodes").rglob("*.parquet"))]
    rows: list[dict[str, Any]] = pads.dataset(files).to_table(columns=["episode_index", "recorded"]).to_pylist()
    return rows


def recorded_episode(row: Mapping[str, Any]) -> int:
    """Returns the number, in its recording, of a converted episode."""
    return int(json.loads(row["recorded"])["episode"])


def played_again(converted: Path, seeds: Mapping[int, int]) -> tuple[int, int]:
    """Plays each converted episode's actions in the scene of its seed: (how many opened the door, of how many)."""
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    made = rows_of(converted, schema.ACTION, schema.DONE, "episode_index")
    env = KeyframeEnv("microwave", split="test", observe_images=False)
    opened, origins = 0, [recorded_episode(row) for row in episodes_of(converted)]
    try:
        for episode, origin in enumerate(origins):
            mine = (made["episode_index"] == episode) & ~made[schema.DONE].astype(bool).ravel()
            env.reset(seed=seeds[origin])
            for action in made[schema.ACTION][mine]:
                _, _, success, truncated, _ = env.step(np.asarray(action, np.float32))
                if success or truncated:
                    break
            opened += bool(success)
    finally:
        env.close()
    return opened, len(origins)


def mixed_training(run: Run, recorded: Path, simulated: Path, out: Path, steps: int = STEPS) -> list[float]:
    """Trains on key frames of the recording and simulated demonstrations together; returns the losses told."""
    run("adamanip", "keyframes", str(recorded), str(simulated), "--out", str(out / "mix"))
    log = run(
        "lerobot-train",
        "--policy.type=dp3_adaptive",
        "--policy.device=cpu",
        "--policy.push_to_hub=false",
        "--dataset.repo_id=local/mix",
        f"--dataset.root={out / 'mix'}",
        "--batch_size=32",
        "--num_workers=0",
        f"--steps={steps}",
        f"--save_freq={steps}",
        f"--log_freq={max(1, steps // 15)}",
        f"--output_dir={out / 'trained'}",
    )
    return [float(value) for value in re.findall(r" loss:([0-9.]+)", log.read_text(errors="replace"))]
