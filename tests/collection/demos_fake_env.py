"""A key-frame environment without a simulator: fast, deterministic, and able to fail in every way that matters."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrameLabels, KeyFrames, Outcome, Phase
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.contract.versions import software_versions
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.experts import Belief
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import UnreachableError

UNREACHABLE_SHARE = 0.2
EXPERT_FAILS_SHARE = 0.3
OPEN_AT = 0.5


class FakeEnv:
    """Opens when the goal's x exceeds 0.5; while locked, a try stalls. Its state depends on nothing but the seed."""

    max_key_frames = 20
    task_description = "open the fake"
    joint_names = ("lid",)

    def __init__(
        self, options: EnvironmentOptions, *, delay: float, crash: str | None, hopeless: str | None, code: str
    ) -> None:
        self.options = options
        self.num_points, self.image_size = options.num_points, options.image_size
        self.delay, self.crash, self.hopeless, self.code = delay, crash, hopeless, code
        self.annotations: Mapping[str, Any] = {}

    def software_versions(self) -> dict[str, str]:
        return {**software_versions(), "code": self.code}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        wanted = options or {}
        self.object_id = wanted["object_id"]
        if self.crash is not None and _crashes(self.crash, self.object_id):
            os.kill(os.getpid(), signal.SIGKILL)
        self.seed = seed
        self.generator = np.random.default_rng(seed)
        if self.generator.random() < UNREACHABLE_SHARE or self.object_id == self.hopeless:
            raise UnreachableError("no layout")
        self.locked = bool(self.generator.random() < 0.5)
        self.locked = {**self.options.hidden_overrides, **wanted.get("hidden_overrides", {})}.get("locked", self.locked)
        self.drawn, self.lid, self.opened = self.locked, 0.0, False
        self.pose = transform((0.3, 0.0, 0.2))
        self.feedback, self.labels = Feedback(self.pose, 1.0), KeyFrameLabels()
        self.steps, self.tries = 0, list[list[int | bool]]()
        return self.observe(), {"is_success": False}

    def restart_episode(self) -> None:
        self.steps, self.tries, self.labels = 0, [], KeyFrameLabels()

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        opened, truncated = self.drive(action)
        return self.observe(), 0.0, opened, truncated, {"is_success": opened}

    def drive(self, action: np.ndarray) -> tuple[bool, bool]:
        time.sleep(self.delay)
        self.steps += 1
        pulls = bool(action[0] > 0.4 and action[schema.GRIPPER_DIM] < 0.5)
        stalled = self.locked and pulls
        failed = self.labels.trial + self.labels.failed
        way = 0.0 if stalled else float(action[0]) - self.pose[0, 3]
        self.labels = KeyFrameLabels(0, stalled, way, failed, 1) if pulls else KeyFrameLabels(trial=failed)
        self.tries += [[0, 1, stalled]] if pulls else []
        if action[2] > 0.5:
            self.locked = False
        if not stalled:
            self.pose = transform(action[:3])
            self.lid = float(action[0]) if pulls else self.lid
        self.feedback = Feedback(self.pose, float(action[-1]), Outcome.STALLED if stalled else Outcome.REACHED)
        self.opened = self.opened or (not self.locked and self.lid > OPEN_AT)
        return self.opened, not self.opened and self.steps >= self.max_key_frames

    def part_positions(self) -> dict[str, float]:
        return {"lid": self.lid}

    def joints(self) -> np.ndarray:
        moved = np.zeros(len(schema.JOINT_NAMES), np.float32)
        moved[0], moved[9] = self.pose[0, 3], self.lid
        return moved

    def render(self) -> np.ndarray:
        return self.pictures_at(self.joints())["front"]

    def pictures_at(self, joints: np.ndarray) -> dict[str, np.ndarray]:
        return {
            name: self.picture(joints) ^ np.uint8(255 * number)
            for number, name in enumerate(self.options.observed_cameras)
        }

    def picture(self, joints: np.ndarray) -> np.ndarray:
        corner = np.array((100 * joints[0], 100 * joints[9], (self.seed or 0) % 251), np.uint8)
        return np.full((self.image_size, self.image_size, 3), corner, dtype=np.uint8)

    def hidden_state(self) -> dict[str, Any]:
        return {"locked": self.drawn}

    def episode_record(self) -> dict[str, Any]:
        return {"seed": self.seed, "object_id": self.object_id, "key_frames": self.steps, "try_sequence": self.tries}

    def camera_parameters(self) -> dict[str, Any]:
        x = 0.01 * (self.seed or 0)
        return {"intrinsics": np.eye(3).tolist(), "cam_in_base": transform((x, 0, 0)).tolist(), "width": 8, "height": 8}

    def close(self) -> None:
        pass

    def observe(self) -> dict[str, Any]:
        state = self.generator.normal(size=schema.STATE_DIM).astype(np.float32)
        state[:3] = self.pose[:3, 3]
        return {
            **({"pixels": self.pictures_at(self.joints())} if self.options.observe_images else {}),
            "agent_pos": state,
            "effort": self.generator.normal(size=schema.NUM_JOINTS).astype(np.float32),
            "point_cloud": self.generator.normal(size=(self.num_points, 3)).astype(np.float32),
        }


def _crashes(crash: str, object_id: str) -> bool:
    """``once:MARKER`` crashes the first time only; any other text is the id of an object that always crashes."""
    kind, _, marker = crash.partition(":")
    if kind != "once":
        return object_id == crash
    return _first_time(Path(marker))


def _first_time(marker: Path) -> bool:
    if marker.exists():
        return False
    marker.touch()
    return True


def make_env(
    options: EnvironmentOptions,
    *,
    delay: float = 0.0,
    crash: str | None = None,
    hopeless: str | None = None,
    broken: bool = False,
    code: str = "a",
    crash_point: str | None = None,
    built: Path | None = None,
) -> FakeEnv:
    """Builds the fake; ``crash_point`` ends the process where `files` passes it, ``built`` notes that it was built."""
    if broken:
        raise RuntimeError("no simulator here")
    if crash_point is not None:
        files.on_crash_point = lambda name: os._exit(9) if name == crash_point else None
    if built is not None:
        built.touch()
    return FakeEnv(options, delay=delay, crash=crash, hopeless=hopeless, code=code)


def make_expert(
    category: str,
    kind: str,
    annotations: Mapping[str, Any],
    *,
    trials: int = 1,
    generator: np.random.Generator,
    hidden: Mapping[str, Any] | None = None,
    strategy: str = "paper",
    mechanism_rules: str = "paper",
    positions: Mapping[str, float] | None = None,
    feedback: Feedback | None = None,
    belief: Belief | None = None,
) -> KeyFrames:
    """Pulls; where that stalls, unlocks and pulls again, and then farther. Sometimes it gives up."""
    assert (hidden is None) == (kind == "adaptive")
    assert (positions is None) == (feedback is None)
    if belief is not None:
        assert feedback is not None
        yield from _corrections(belief, positions or {}, feedback)
        return
    y = float(generator.normal(scale=0.1))
    if generator.random() < EXPERT_FAILS_SHARE:
        yield Goal(transform((0.35, y, 0.2)), 1.0, Phase.APPROACH)
        return
    yield Goal(transform((0.4, y, 0.2)), 1.0, Phase.APPROACH)
    if hidden is None:
        feedback = yield Goal(transform((0.6, y, 0.2)), 0.0, Phase.TRY)
        if feedback.failed:
            yield Goal(transform((0.3, y, 0.6)), 0.0, Phase.UNLOCK)
            yield Goal(transform((0.6, y, 0.2)), 0.0, Phase.OPEN)
    else:
        if hidden["locked"]:
            yield Goal(transform((0.3, y, 0.6)), 0.0, Phase.UNLOCK)
        yield Goal(transform((0.45, y, 0.2)), 0.0, Phase.OPEN)
        yield Goal(transform((0.6, y, 0.2)), 0.0, Phase.OPEN)
    yield Goal(transform((0.65, y, 0.2)), 0.0, Phase.OPEN)


def _corrections(belief: Belief, positions: Mapping[str, float], feedback: Feedback) -> KeyFrames:
    """Unlocks after a try that failed, unless it has just done so; has nothing left to do once it is open."""
    if positions["lid"] > OPEN_AT:
        return
    unlocks = belief.blocked("lid") and feedback.tcp_in_base[2, 3] < OPEN_AT
    phase = Phase.UNLOCK if unlocks else Phase.TRY
    yield Goal(transform((0.3, 0.0, 0.6) if unlocks else (0.6, 0.0, 0.2)), 0.0, phase)


class FakeActor:
    """Goes anywhere; what it leaves to chance follows from the seed it is reset with."""

    def __init__(self) -> None:
        self.told: list[np.ndarray] = []

    def reset(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)
        self.remembered: list[np.ndarray] = []

    def act(self, observation: Any, instruction: str) -> np.ndarray:
        assert instruction == FakeEnv.task_description
        position = (*self.generator.uniform(0.3, 0.45, 2), 0.2)
        action = Goal(transform(position), float(self.generator.integers(2)), Phase.TRY).action()
        self.remembered.append(action)
        return action

    def executed(self, action: np.ndarray) -> None:
        self.remembered[-1] = action
        self.told.append(action)
