"""Driving environments with experts, and comparing what was observed byte for byte."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lerobot_adamanip.experts import Phase, make_expert

ROOT = Path(__file__).resolve().parents[2]
SMALL: dict[str, Any] = {"num_points": 128, "image_size": 64, "split": "test"}


NO_VULKAN = {"VK_ICD_FILENAMES": "/nonexistent.json", "VK_DRIVER_FILES": "/nonexistent.json"}
"""Environment of a process that finds no Vulkan device."""


def at_once_or_at_night(name: str, values: Iterable[str], at_once: Collection[str]) -> pytest.MarkDecorator:
    """Parametrizes what hardly depends on the value: some with every change, the others at night."""
    marks = {value: () if value in at_once else pytest.mark.nightly for value in values}
    return pytest.mark.parametrize(name, [pytest.param(value, marks=mark) for value, mark in marks.items()])


def digest(observation: dict[str, Any]) -> str:
    """One hash of every byte, dtype and shape of an observation."""
    made = hashlib.sha256()
    flat = {**observation, **observation.get("pixels", {})}
    flat.pop("pixels", None)
    for key in sorted(flat):
        made.update(f"{key}{flat[key].dtype}{flat[key].shape}".encode())
        made.update(np.ascontiguousarray(flat[key]).tobytes())
    return made.hexdigest()


def expert_episode(
    env: Any, seed: int, *, kind: str = "adaptive", expert_seed: int = 0, **options: Any
) -> tuple[list[str], list[Phase], dict[str, Any]]:
    """Runs an expert through an episode: hashes of all observations, phases of the key frames, the last info."""
    observation, info = env.reset(seed=seed, options=options)
    hidden = env.hidden_state() if kind == "static" else None
    rng = np.random.default_rng(expert_seed)
    expert = make_expert(env.category, kind, env.annotations, generator=rng, hidden=hidden)
    hashes, phases, goal = [digest(observation)], [], next(expert)
    while True:
        observation, _, terminated, truncated, info = env.step(goal.action())
        hashes.append(digest(observation))
        phases.append(goal.phase)
        if terminated or truncated:
            return hashes, phases, info
        try:
            goal = expert.send(env.feedback)
        except StopIteration:
            return hashes, phases, info


def grasp_handle(env: Any) -> None:
    """The three key frames after which the hand holds the handle."""
    expert = make_expert("safe", "adaptive", env.annotations, generator=np.random.default_rng(0))
    goal = next(expert)
    while goal.phase in (Phase.APPROACH, Phase.GRASP):
        env.step(goal.action())
        goal = expert.send(env.feedback)


def stay(env: Any) -> NDArray[np.float32]:
    """An action that asks the arm to be where it is, hand open."""
    from lerobot_adamanip.contract.rotations import pose_vector

    return pose_vector(env.feedback.tcp_in_base, 1.0)


def in_fresh_process(code: str, **environment: str) -> Any:
    """Runs code that prints JSON on its last line in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, **environment},
        timeout=280,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return json.loads(done.stdout.strip().splitlines()[-1])
