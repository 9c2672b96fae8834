"""What is hidden stays hidden until the action that tells: for every category, by comparison and by a classifier."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from envs_helpers import SMALL, OneSimulator, digest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import binom

from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.experts import Phase, make_expert
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
EPISODES = 24


@pytest.fixture
def env(category: str, simulator: OneSimulator) -> Any:
    return simulator.get(category, lambda: KeyframeEnv(category, **SMALL))


def until_it_holds_and_after(
    env: KeyframeEnv, seed: int, hidden: dict[str, Any]
) -> tuple[list[str], dict[str, Any], list[str]]:
    """Hashes until the hand touches the object, what is seen once it holds it, and hashes of the motions tried then."""
    observation, _ = env.reset(seed=seed, options={"hidden_overrides": hidden})
    expert = make_expert(env.category, "adaptive", env.annotations, generator=np.random.default_rng(0))
    before, tried, goal = [digest(observation)], [], next(expert)
    while goal.phase in (Phase.APPROACH, Phase.GRASP):
        observation = env.step(goal.action())[0]
        before.append(digest(observation))
        goal = expert.send(env.feedback)
    held = observation
    for _ in range(3):
        observation, _, ended, truncated, _ = env.step(goal.action())
        tried.append(digest(observation))
        if ended or truncated:
            break
        goal = expert.send(env.feedback)
    return before[:-1], held, tried


@every_category
def test_nothing_shows_before_the_action_that_tells(env: KeyframeEnv, category: str) -> None:
    """Cloud, image, state and effort are equal bit for bit until the hand closes, and up to rounding once it holds."""
    runs = [until_it_holds_and_after(env, 31, hidden) for hidden in HIDDEN[category]]
    assert len(runs[0][0]) == 3  # reset and two approaches
    assert all(before == runs[0][0] for before, _, _ in runs)
    first = runs[0][1]
    for _, held, _ in runs[1:]:
        # The physics engine starts its iterations from the contacts of before: joints that were free, or not.
        for key in ("agent_pos", "effort"):
            np.testing.assert_allclose(held[key], first[key], atol=1e-3)
        distances, _ = cKDTree(first["point_cloud"]).query(held["point_cloud"])
        assert np.quantile(distances, 0.98) < 1e-3  # one point may take another's place in the sample
        assert np.abs(held["pixels"]["front"].astype(int) - first["pixels"]["front"].astype(int)).mean() < 0.1
    assert len({tuple(tried) for _, _, tried in runs}) > 1


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
