"""A key-frame environment without a simulator: fast, deterministic, and able to fail in every way that matters."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip import schema
from lerobot_adamanip.errors import UnreachableError
from lerobot_adamanip.keyframes import Feedback, Goal, KeyFrames, Outcome, Phase
from lerobot_adamanip.rotations import transform

ENV_FACTORY = "demos_fake_env:make_env"
EXPERT_FACTORY = "demos_fake_env:make_expert"
UNREACHABLE_SHARE = 0.2
EXPERT_FAILS_SHARE = 0.3


class FakeEnv:
    """Opens when the goal's x exceeds 0.5; while locked, a try stalls. Its state depends on nothing but the seed."""

    max_key_frames = 12
    task_description = "open the fake"

    def __init__(
        self, num_points: int, image_size: int, *, delay: float, crash: str | None, hopeless: str | None
    ) -> None:
        self.num_points, self.image_size = num_points, image_size
        self.delay, self.crash, self.hopeless = delay, crash, hopeless
        self.annotations: Mapping[str, Any] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self.object_id = (options or {})["object_id"]
        if self.crash is not None and _crashes(self.crash, self.object_id):
            os.kill(os.getpid(), signal.SIGKILL)
        self.seed = seed
        self.generator = np.random.default_rng(seed)
        if self.generator.random() < UNREACHABLE_SHARE or self.object_id == self.hopeless:
            raise UnreachableError("no layout")
        self.locked = bool(self.generator.random() < 0.5)
        self.pose = transform((0.3, 0.0, 0.2))
        self.feedback = Feedback(self.pose, 1.0)
        self.steps = 0
        return self._observation(), {"is_success": False}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        time.sleep(self.delay)
        self.steps += 1
        stalled = self.locked and action[0] > 0.4 and action[schema.GRIPPER_DIM] < 0.5
        if action[2] > 0.5:
            self.locked = False
        if not stalled:
            self.pose = transform(action[:3])
        self.feedback = Feedback(self.pose, float(action[-1]), Outcome.STALLED if stalled else Outcome.REACHED)
        success = not self.locked and self.pose[0, 3] > 0.5
        return self._observation(), 0.0, success, self.steps >= self.max_key_frames, {"is_success": success}

    def hidden_state(self) -> dict[str, Any]:
        return {"locked": self.locked}

    def episode_record(self) -> dict[str, Any]:
        return {"seed": self.seed, "object_id": self.object_id, "key_frames": self.steps}

    def camera_parameters(self) -> dict[str, Any]:
        x = 0.01 * (self.seed or 0)
        return {"intrinsics": np.eye(3).tolist(), "cam_in_base": transform((x, 0, 0)).tolist(), "width": 8, "height": 8}

    def close(self) -> None:
        pass

    def _observation(self) -> dict[str, Any]:
        state = self.generator.normal(size=schema.STATE_DIM).astype(np.float32)
        state[:3] = self.pose[:3, 3]
        corner = self.generator.integers(0, 256, 3, dtype=np.uint8)
        image = np.full((self.image_size, self.image_size, 3), corner, dtype=np.uint8)
        return {
            "pixels": {"front": image},
            "agent_pos": state,
            "effort": self.generator.normal(size=schema.NUM_JOINTS).astype(np.float32),
            "point_cloud": self.generator.normal(size=(self.num_points, 3)).astype(np.float32),
        }


def _crashes(crash: str, object_id: str) -> bool:
    """``once:MARKER`` crashes the first time only; any other text is the id of an object that always crashes."""
    kind, _, marker = crash.partition(":")
    if kind != "once":
        return object_id == crash
    if Path(marker).exists():
        return False
    Path(marker).touch()
    return True


def make_env(
    category: str,
    num_points: int,
    *,
    image_size: int = 64,
    delay: float = 0.0,
    crash: str | None = None,
    hopeless: str | None = None,
    broken: bool = False,
) -> FakeEnv:
    if broken:
        raise RuntimeError("no simulator here")
    return FakeEnv(num_points, image_size, delay=delay, crash=crash, hopeless=hopeless)


def make_expert(
    category: str,
    kind: str,
    annotations: Mapping[str, Any],
    *,
    trials: int = 1,
    generator: np.random.Generator,
    hidden: Mapping[str, Any] | None = None,
) -> KeyFrames:
    """Pulls; where that stalls, unlocks and pulls again. Sometimes it gives up."""
    assert (hidden is None) == (kind == "adaptive")
    y = float(generator.normal(scale=0.1))
    if generator.random() < EXPERT_FAILS_SHARE:
        yield Goal(transform((0.35, y, 0.2)), 1.0, Phase.APPROACH)
        return
    yield Goal(transform((0.4, y, 0.2)), 1.0, Phase.APPROACH)
    trial = 0
    if hidden is None:
        feedback = yield Goal(transform((0.6, y, 0.2)), 0.0, Phase.TRY)
        if not feedback.failed:
            return
        trial = 1
    yield Goal(transform((0.3, y, 0.6)), 0.0, Phase.UNLOCK, trial)
    yield Goal(transform((0.6, y, 0.2)), 0.0, Phase.OPEN, trial)
