"""Simulated episodes tick by tick: what is watched is what was driven, and watching changes nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.collection.record import EpisodeRequest, attempt_episode
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.hardware.features import KEY_FRAMES
from lerobot_adamanip.recordings.keyframe_choice import choose_key_frames, stays
from lerobot_adamanip.util.errors import DatasetError
from lerobot_env_adamanip.dense import FPS, TickWatch, collect_dense, dense_episode
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim
OBJECT, SEED = "microwave_000", 1_000_007
NEAR = 0.4
"""Largest time between a key frame's end and the tick that was found for it [s]."""


def spec() -> CollectionSpec:
    environment = EnvironmentOptions("microwave", objects=OBJECT, num_points=64, observe_images=False)
    return CollectionSpec(environment, (OBJECT,), episodes_per_object=1, late_starts=0.0)


def test_watching_changes_nothing_and_key_frames_are_found_again() -> None:
    plan = spec()
    env = KeyframeEnv(options=plan.environment_of("microwave"))
    try:
        _, alone = attempt_episode(env, plan, make_expert, EpisodeRequest(OBJECT, SEED))
        watch = TickWatch(env)
        episode, known = dense_episode(watch, plan, make_expert, EpisodeRequest(OBJECT, SEED))
    finally:
        env.close()
    np.testing.assert_array_equal(known.actions, alone.columns[schema.ACTION][:-1])
    # At a key frame's end the recording tells what the observation told.
    told = alone.columns[schema.STATE]
    np.testing.assert_allclose(episode.state[known.ends], told[1:], atol=1e-6)
    np.testing.assert_allclose(episode.state[0], told[0], atol=1e-6)
    found = choose_key_frames(episode, FPS)
    apart = np.abs(found.rows[1:, None] - known.ends) / FPS
    spans = zip([0, *known.ends], known.ends, strict=False)
    moved = [not stays(episode.pose[begin : end + 1], same_place=0.01) for begin, end in spans]
    assert (apart.min(axis=0)[moved] <= NEAR).mean() >= 0.95  # what was driven, and moved something, is found
    assert (apart.min(axis=1) <= NEAR).mean() >= 0.95  # and what is found was driven


def test_a_dense_collection_is_a_recording_that_goes_on(tmp_path: Path) -> None:
    root = tmp_path / "dense"
    assert collect_dense(root, spec(), make_expert, max_attempts=5) == 1
    lines: list[dict[str, Any]] = [json.loads(line) for line in (root / KEY_FRAMES).read_text().splitlines()]
    assert [line["success"] for line in lines] == [True]
    assert check(root).findings == []
    assert collect_dense(root, spec(), make_expert, max_attempts=5) == 1  # nothing is left to do
    before = (root / KEY_FRAMES).read_bytes()
    with pytest.raises(DatasetError, match="something else at the root"):
        collect_dense(root, replace(spec(), seed=1, episodes_per_object=2), make_expert, max_attempts=5)
    assert (root / KEY_FRAMES).read_bytes() == before
