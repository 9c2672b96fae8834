"""Demonstrations of the fake environment that are sound in every value: what `adamanip check` finds nothing in."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import demos_fake_env
import numpy as np
from demos_helpers import make_spec, patiently

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.record import Factories
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.contract.seeds import split_of
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.evaluation.record import EpisodeRecord, Provenance

POINTS, PIXELS = 16, 64


class SoundEnv(demos_fake_env.FakeEnv):
    """Points in the workspace, tools turned by rotations, pictures of one colour an episode, a record of every try."""

    def observe(self) -> dict[str, Any]:
        pose = pose_vector(self.pose, float(self.generator.random()))
        rest = self.generator.normal(size=schema.STATE_DIM - schema.ACTION_DIM)
        lower, upper = np.array(DEFAULT_WORKSPACE.lower), np.array(DEFAULT_WORKSPACE.upper)
        cloud = self.generator.uniform(lower, upper, (self.num_points, 3))
        return {
            **({"pixels": self.pictures_at(self.joints())} if self.options.observe_images else {}),
            "agent_pos": np.concatenate([pose, rest]).astype(np.float32),
            "effort": self.generator.normal(size=schema.NUM_JOINTS).astype(np.float32),
            "point_cloud": cloud.astype(np.float32),
        }

    def picture(self, joints: np.ndarray) -> np.ndarray:
        colour = np.array(
            (40 + (self.seed or 0) % 151, 40 + (self.seed or 0) // 7 % 151, 90 + 10 * joints[0]), np.uint8
        )
        return np.full((self.image_size, self.image_size, 3), colour, dtype=np.uint8)

    def episode_record(self) -> dict[str, Any]:
        seed = self.seed or 0
        return EpisodeRecord(
            seed=seed,
            given_seed=seed,
            split=split_of(seed),
            object_id=self.object_id,
            object_split="seen",
            hidden_state=self.hidden_state(),
            success=self.opened,
            key_frames=self.steps,
            max_key_frames=45,
            clipped_goals=0,
            max_failed_tries=None,
            poses="randomized",
            try_sequence=tuple((int(part), int(way), bool(failed)) for part, way, failed in self.tries),
            provenance=Provenance(SIMULATION_VERSION, "0", "paper"),
        ).to_json()


def make_sound_env(options: EnvironmentOptions) -> SoundEnv:
    """Builds a `SoundEnv`."""
    return SoundEnv(options, delay=0.0, crash=None, hopeless=None, code="a")


def collect_sound(root: Path, **changes: Any) -> Path:
    """A complete dataset, with a video, of six episodes of two safes; returns its folder."""
    made = functools.partial(make_sound_env)
    spec = make_spec(num_points=POINTS, image_size=PIXELS, **changes)
    collect(root, spec, Factories(made, demos_fake_env.make_expert), patiently())
    return root
