"""Demonstrations at control rate of a fake environment, sound in every value."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import demos_fake_env
import numpy as np
from demos_helpers import patiently
from sound_demos import PIXELS, POINTS, SoundEnv

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.record import Factories
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import EE_DELTA, EE_POSE, POSE
from lerobot_adamanip.contract.dense_codec import delta_action, pose_of_delta, pose_state
from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION, Feedback, KeyFrameLabels
from lerobot_adamanip.contract.rotations import pose_vector, transform
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.episode.options import EnvironmentOptions

FULL = {"observe_cloud": True, "observe_effort": True, "state": "full"}
"""Options of dense datasets that have all columns of key frames."""


class DenseFakeEnv(SoundEnv):
    """As `FakeEnv`, at control rate: the tool goes at once where it is sent, unless it pulls a locked lid."""

    motion_limits = DEFAULT_MOTION
    is_unreachable = False
    is_at_rest = True
    is_blocked = False

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        position, gripper = self._target(action)
        self.steps += 1
        pulls = bool(position[0] > 0.41 and gripper < 0.5)
        self.is_blocked = self.locked and pulls
        is_new = pulls and (self.labels.tried < 0 or self.labels.failed != self.is_blocked)
        self.tries += [[0, 1, self.is_blocked]] if is_new else []
        way = 0.0 if self.is_blocked else float(position[0]) - self.pose[0, 3]
        failed = sum(fails for _, _, fails in self.tries[:-1])
        self.labels = KeyFrameLabels(0, self.is_blocked, way, failed, 1, len(self.tries) - 1)
        self.labels = self.labels if pulls else KeyFrameLabels()
        self.locked = self.locked and position[2] <= 0.5
        if not self.is_blocked:
            self.pose = transform(position)
            self.lid = float(position[0]) if pulls else self.lid
        self.feedback = Feedback(self.pose, gripper)
        self.opened = self.opened or (not self.locked and self.lid > demos_fake_env.OPEN_AT)
        truncated = not self.opened and self.steps >= self.options.step_limit
        return self.observe(), 0.0, self.opened, truncated, {"is_success": self.opened}

    def action_toward(self, target: np.ndarray, gripper: float) -> np.ndarray:
        if self.options.action == EE_DELTA:
            return delta_action(target, gripper, self.pose)
        if self.options.action == EE_POSE:
            return pose_vector(target, gripper)
        return np.array([*target[:3, 3], -1.0, 0.0, 1.0, 0.0, gripper], np.float32)

    def _target(self, action: np.ndarray) -> tuple[np.ndarray, float]:
        pose = pose_of_delta(action, self.pose) if self.options.action == EE_DELTA else action
        return np.asarray(pose[:3], np.float64), float(pose[-1])

    def pictures_at(self, joints: np.ndarray) -> dict[str, np.ndarray]:
        pictures = super().pictures_at(joints)
        return {name: pictures[name] for name in self.options.observed_cameras}

    def observe(self) -> dict[str, Any]:
        observation, options = super().observe(), self.options
        if options.state == POSE:
            observation["agent_pos"] = pose_state(self.pose, self.feedback.gripper)
        else:
            observation["agent_pos"][: schema.ACTION_DIM] = pose_vector(self.pose, self.feedback.gripper)
        for name, is_observed in (("point_cloud", options.observes_cloud), ("effort", options.observes_effort)):
            if not is_observed:
                del observation[name]
        return observation


def make_dense_env(options: EnvironmentOptions, *, code: str = "a") -> SoundEnv:
    """Builds the fake environment for either control."""
    kind = DenseFakeEnv if options.is_dense else SoundEnv
    return kind(options, delay=0.0, crash=None, hopeless=None, code=code)


DENSE_FAKES = Factories(functools.partial(make_dense_env), demos_fake_env.make_expert)


def dense_spec(**changes: Any) -> CollectionSpec:
    """A small collection at control rate, with changes of its or its environment's options."""
    own = {"episodes_per_object": 2, "late_starts": 0.3, "objects": ("safe_000", "safe_001")}
    values = {key: changes.pop(key, value) for key, value in own.items()}
    values |= {key: changes.pop(key) for key in ("keep_failed", "seed", "policy", "expert_share") if key in changes}
    options = {"control": "dense", "observe_images": True, "num_points": POINTS, "image_size": PIXELS, **changes}
    return CollectionSpec(EnvironmentOptions("safe", objects=values["objects"][0], **options), **values)


def collect_dense(root: Path, **changes: Any) -> Path:
    """A complete dataset of four episodes of two safes; returns its folder."""
    collect(root, dense_spec(**changes), DENSE_FAKES, patiently())
    return root
