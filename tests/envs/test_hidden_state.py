"""What is hidden stays hidden until the action that tells: for every category, by comparison and by a classifier."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from envs_helpers import SMALL, digest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import binom

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.experts import Phase, make_expert
from lerobot_adamanip.rotations import angle_between, matrix_from_rotation_6d
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim
LOCK = [{"locked": locked, "direction": direction} for locked in (True, False) for direction in (1, -1)]
TWIST = [{"direction": direction, "turn_range": turn_range} for direction in (1, -1) for turn_range in (0.45, 1.0)]
HIDDEN: dict[str, list[dict[str, Any]]] = {
    **dict.fromkeys(CATEGORIES, TWIST),
    "safe": LOCK,
    "microwave": [{"locked": True}, {"locked": False}],
    "lamp": [{"mode": mode} for mode in range(3)],
}
every_category = pytest.mark.parametrize("category", CATEGORIES)
EPISODES = 40
POSITION_NOISE, ROTATION_NOISE = 1.5e-3, 0.012
"""Fingers that close centre what is free to move on themselves: so far may a held tool differ [m, rad]."""
CLOUD_NOISE, IMAGE_NOISE = 2.5e-3, 1.5
"""Mean distance of points [m], mean difference of pixels [of 255]."""


@pytest.fixture(scope="module")
def envs() -> Iterator[dict[str, KeyframeEnv]]:
    made: dict[str, KeyframeEnv] = {}
    yield made
    for env in made.values():
        env.close()


@pytest.fixture
def env(category: str, envs: dict[str, KeyframeEnv]) -> KeyframeEnv:
    if category not in envs:
        for other in envs.values():
            other.close()  # one simulator at a time
        envs.clear()
        envs[category] = KeyframeEnv(category, **SMALL)
    return envs[category]


def until_touch_and_after(env: KeyframeEnv, seed: int, hidden: dict[str, Any]) -> tuple[list[str], dict[str, Any]]:
    """Hashes of the observations until the hand touches the object, and the observation once it holds it."""
    observation, _ = env.reset(seed=seed, options={"hidden_overrides": hidden})
    expert = make_expert(env.category, "adaptive", env.annotations, generator=np.random.default_rng(0))
    hashes, goal = [digest(observation)], next(expert)
    while goal.phase is Phase.APPROACH:
        observation = env.step(goal.action())[0]
        hashes.append(digest(observation))
        goal = expert.send(env.feedback)
    assert goal.phase is Phase.GRASP
    return hashes, env.step(goal.action())[0]


@every_category
@pytest.mark.parametrize("seed", [31, 32])
def test_nothing_shows_before_the_action_that_tells(env: KeyframeEnv, category: str, seed: int) -> None:
    runs = [until_touch_and_after(env, seed, hidden) for hidden in HIDDEN[category]]
    assert all(len(hashes) == 3 and hashes == runs[0][0] for hashes, _ in runs)  # bit for bit
    first = runs[0][1]
    for _, held in runs[1:]:
        assert np.linalg.norm(held["agent_pos"][:3] - first["agent_pos"][:3]) < POSITION_NOISE
        turned = angle_between(*(matrix_from_rotation_6d(each["agent_pos"][3:9]) for each in (held, first)))
        assert turned < ROTATION_NOISE
        pixels = held["pixels"]["front"].astype(int) - first["pixels"]["front"].astype(int)
        assert np.abs(pixels).mean() < IMAGE_NOISE
        distances, _ = cKDTree(first["point_cloud"]).query(held["point_cloud"])
        assert np.median(distances) < CLOUD_NOISE


def leave_one_out(features: NDArray[np.float64], labels: NDArray[np.int64]) -> int:
    """How often the nearest other episode has the same label."""
    scaled = (features - features.mean(0)) / (features.std(0) + 1e-9)
    distances = np.linalg.norm(scaled[:, None] - scaled[None], axis=-1)
    np.fill_diagonal(distances, np.inf)
    return int((labels[distances.argmin(1)] == labels).sum())


def features_of(observation: dict[str, Any]) -> NDArray[np.float64]:
    """State, effort, moments of the cloud, and a thumbnail."""
    cloud = observation["point_cloud"]
    thumbnail = observation["pixels"]["front"].reshape(8, 8, 8, 8, 3).mean(axis=(1, 3))
    parts = (observation["agent_pos"], observation["effort"], cloud.mean(0), cloud.std(0), thumbnail.ravel())
    return np.concatenate([np.ravel(part).astype(np.float64) for part in parts])


@every_category
def test_a_classifier_of_first_observations_stays_at_chance(env: KeyframeEnv, category: str) -> None:
    seen, labels = [], []
    for seed in range(500, 500 + EPISODES):
        observation, _ = env.reset(seed=seed)
        hidden = env.hidden_state()
        label = hidden.get("locked", hidden.get("direction", hidden.get("mode")))
        seen.append(features_of(observation))
        labels.append(int(label))
    features, classes = np.stack(seen), np.array(labels)
    counts = np.unique(classes, return_counts=True)[1]
    assert len(counts) == (3 if category == "lamp" else 2)
    chance = float(counts.max() / EPISODES)
    limit = binom.ppf(0.999, EPISODES, chance)
    assert leave_one_out(features, classes) <= limit
    # The classifier is no fool: were the hidden state in the picture, it would say so.
    leaky = np.concatenate([features[:, :20], 30.0 * classes[:, None] + features[:, :1]], axis=1)
    assert leave_one_out(leaky[:, -1:], classes) > limit
