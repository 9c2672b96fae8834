"""Environments at control rate: conventions of actions and states, limits, and equality with key frames."""

from __future__ import annotations

import itertools
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from envs_helpers import at_once_or_at_night
from numpy.typing import NDArray

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, DELTA_POSITION, DELTA_ROTATION, FINGER_TRAVEL, STATES
from lerobot_adamanip.contract.dense_codec import (
    continuous_rotation_vector,
    delta_action,
    pose_of_delta,
    pose_state,
)
from lerobot_adamanip.contract.rotations import pose_from_vector, rotation_about, transform
from lerobot_adamanip.contract.seeds import Stream, episode_generator
from lerobot_adamanip.episode.dense import dense_rollout
from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.dense_env import DenseEnv
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

Array = NDArray[np.float64]
DOWN = np.diag([1.0, -1.0, -1.0])
"""Rotation of a tool that points down."""
FORWARD = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Rotation of a level tool that points forward."""


# Conventions ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rotation", [DOWN, FORWARD])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_the_rotation_vector_of_a_tool_does_not_jump(rotation: Array, axis: tuple[float, float, float]) -> None:
    angles = np.linspace(-0.7, 0.7, 141)
    vectors = [continuous_rotation_vector(rotation_about(axis, angle) @ rotation) for angle in angles]
    assert max(np.abs(np.diff(vectors, axis=0)).max(axis=1)) < 0.05
    for vector, angle in zip(vectors, angles, strict=True):
        size = float(np.linalg.norm(vector))
        assert np.allclose(rotation_about(vector / size, size), rotation_about(axis, angle) @ rotation, atol=1e-6)


def test_an_action_within_the_limits_reaches_its_pose() -> None:
    here = transform((0.5, 0.1, 0.7), DOWN)
    target = transform((0.55, 0.05, 0.74), rotation_about((0.0, 0.0, 1.0), 0.3) @ DOWN)
    reached, gripper = pose_from_vector(pose_of_delta(delta_action(target, 0.25, here), here).astype(np.float64))
    assert np.allclose(reached, target, atol=1e-6)
    assert gripper == pytest.approx(0.25)


def test_deltas_are_along_the_axes_of_the_base_and_in_units_of_their_limits() -> None:
    here = transform((0.5, 0.1, 0.7), FORWARD)
    moved, _ = pose_from_vector(pose_of_delta([0.5, 0, 0, 0, 0, 1.0, 1.0], here).astype(np.float64))
    assert np.allclose(moved[:3, 3] - here[:3, 3], [0.5 * DELTA_POSITION, 0, 0], atol=1e-6)
    assert np.allclose(moved[:3, :3], rotation_about((0.0, 0.0, 1.0), DELTA_ROTATION) @ FORWARD, atol=1e-6)


def test_a_motion_beyond_the_limits_keeps_its_direction() -> None:
    here = transform((0.5, 0.1, 0.7), DOWN)
    target = transform((0.9, -0.1, 0.7), rotation_about((0.0, 0.0, 1.0), 0.5) @ DOWN)
    action = delta_action(target, 1.0, here)
    assert np.abs(action).max() == 1.0
    assert np.allclose(action[:6] / action[0], [1, -0.5, 0, 0, 0, 0.25], atol=1e-5)


def test_the_state_of_a_pose_has_both_fingers() -> None:
    state = pose_state(transform((0.5, 0.1, 0.7), DOWN), 0.5)
    assert state.shape == (len(STATES["pose"]),)
    assert np.allclose(state[6:], 0.5 * FINGER_TRAVEL)


# Steps ----------------------------------------------------------------------------------------------------------------


def dense_env(category: str = "bottle", **options: Any) -> DenseEnv:
    return DenseEnv(category, **{"observe_images": False, **options})


@pytest.mark.sim
@pytest.mark.parametrize(("action", "state"), [("ee_delta", "pose"), ("ee_pose", "full"), ("joint", "pose")])
def test_spaces_have_the_sizes_of_their_names(action: str, state: str) -> None:
    env = dense_env(action=action, state=state, observe_cloud=True, observe_effort=True, num_points=128)
    try:
        assert env.action_space.shape == (len(ACTION_NAMES[action]),)
        observation, _ = env.reset(seed=0)
        assert observation in env.observation_space
        assert observation["agent_pos"].shape == (len(STATES[state]),)
        assert set(observation) == {"agent_pos", "effort", "point_cloud"}
    finally:
        env.close()


@pytest.mark.sim
def test_the_environment_is_registered_with_gymnasium() -> None:
    env = gym.make("AdaManipDense-Safe-v0", observe_images=False, fps=25)
    try:
        assert isinstance(env.unwrapped, DenseEnv)
        env.reset(seed=1)
        _, _, terminated, truncated, info = env.step(np.array([0, 0, 0, 0, 0, 0, 1], np.float32))
        assert not any((terminated, truncated, info["is_success"]))
        assert env.unwrapped.episode.task.simulation.ticks == 2
    finally:
        env.close()


def test_an_environment_refuses_the_other_control() -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)KeyframeEnv with control='dense'.*try:.*DenseEnv"):
        KeyframeEnv("safe", control="dense")
    with pytest.raises(ConfigurationError, match=r"(?s)DenseEnv with control='keyframe'.*try:.*KeyframeEnv"):
        DenseEnv("safe", control="keyframe")
    assert DenseEnv("safe", observe_images=False).options.is_dense


@pytest.mark.sim
def test_malformed_actions_and_unknown_values_are_refused() -> None:
    for name, value in (("fps", 30), ("action", "pose"), ("state", "all"), ("max_steps", 0)):
        with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:"):
            dense_env(**{name: value})
    env = dense_env()
    try:
        env.reset(seed=0)
        for action in (np.zeros(10), np.full(7, np.nan)):
            with pytest.raises(ConfigurationError, match="Malformed action"):
                env.step(action.astype(np.float32))
    finally:
        env.close()


@pytest.mark.sim
def test_an_episode_ends_after_its_steps() -> None:
    env = dense_env(max_steps=3)
    try:
        env.reset(seed=0)
        ends = [env.step(np.array([0, 0, 0, 0, 0, 0, 1], np.float32))[2:4] for _ in range(3)]
        assert ends == [(False, False), (False, False), (False, True)]
        assert env.episode_record()["key_frames"] == env.episode_record()["max_key_frames"] == 3
    finally:
        env.close()


def expert_of(env: KeyframeEnv, seed: int, **options: Any) -> Any:
    generator = episode_generator(seed, Stream.EXPERT, env.category)
    options = {"strategy": "to_stop", **options}
    return make_expert(env.category, "adaptive", env.annotations, generator=generator, **options)


@pytest.mark.sim
@pytest.mark.parametrize("action", ACTION_NAMES)
def test_the_same_actions_give_the_same_episode_to_the_bit(action: str) -> None:
    env = dense_env("safe", action=action)
    try:
        steps: list[Any] = []
        observation, _ = env.reset(seed=2)
        dense_rollout(env, observation, expert_of(env, 2), steps.append)
        record = env.episode_record()
        observation, _ = env.reset(seed=2)
        for step in steps:
            assert observation["agent_pos"].tobytes() == step.observation["agent_pos"].tobytes()
            observation, *_ = env.step(step.action)
        again = env.episode_record()
        assert (again["try_sequence"], again["joints"]) == (record["try_sequence"], record["joints"])
        assert record["success"]
    finally:
        env.close()


def until_it_opens(record: dict[str, Any]) -> list[tuple[int, int, bool]]:
    """Tries up to the first one that moves the part that opens, each once."""
    tries = [tuple(each) for each in record["try_sequence"]]
    moved = [number for number, (joint, _, failed) in enumerate(tries) if joint == 0 and not failed]
    opening = moved[0] if moved else len(tries)  # a lamp is switched on by a knob
    return [key for key, _ in itertools.groupby(tries[: opening + 1])]  # type: ignore[misc]


@pytest.mark.sim
@at_once_or_at_night("category", CATEGORIES, ("bottle", "safe"))
def test_key_frames_and_control_rate_open_an_object_by_the_same_tries(category: str) -> None:
    dense, key = dense_env(category), KeyframeEnv(category, observe_images=False)
    try:
        for seed in (11, 12):
            records = []
            for env, run in ((dense, dense_rollout), (key, rollout)):
                observation, _ = env.reset(seed=seed)
                run(env, observation, expert_of(env, seed))  # type: ignore[operator]
                records.append(env.episode_record())
            assert all(record["success"] for record in records)
            assert records[0]["hidden_state"] == records[1]["hidden_state"]
            assert until_it_opens(records[0]) == until_it_opens(records[1])
    finally:
        dense.close()
        key.close()


@pytest.mark.sim
def test_a_try_that_goes_on_is_not_one_too_many() -> None:
    env = dense_env("safe", max_failed_tries=0, hidden_overrides={"locked": False})
    try:
        observation, _ = env.reset(seed=3)
        assert dense_rollout(env, observation, expert_of(env, 3)).success
        assert (env.episode.record().control, env.episode.record().fps) == ("dense", env.options.fps)
        env.reset(seed=3, options={"hidden_overrides": {"locked": True}})
        result = dense_rollout(env, observation, expert_of(env, 3))
        assert not result.success
        assert "failed tries" in result.reason
    finally:
        env.close()
