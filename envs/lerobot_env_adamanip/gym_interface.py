"""Gymnasium's side of the environments: spaces with finite bounds, specification, and options of a reset."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, FINGER_TRAVEL, JOINT, POSE
from lerobot_adamanip.contract.keyframes import DEFAULT_MOTION
from lerobot_adamanip.contract.memory import EVENTS, MAX_MOTION, MEMORY_NAMES
from lerobot_adamanip.contract.schema import NUM_JOINTS
from lerobot_adamanip.contract.seeds import MAX_SEED
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

NEW_ROLLOUT = "lerobot_new_rollout"
"""Option with which LeRobot resets at the start of a rollout: its `NEW_ROLLOUT_OPTION`, without importing LeRobot."""
RESET_OPTIONS = ("object_id", "hidden_overrides", NEW_ROLLOUT)
RENDER_MODE = "rgb_array"
POSE_LOW, POSE_HIGH = (-2.0, -2.0, -2.0, *[-1.01] * 6, -1.0), (2.0, 2.0, 2.0, *[1.01] * 6, 2.0)
"""Bounds of an observed tool pose: position [m], rotation 6D, gripper. Far outside of what the arm reaches."""
MAX_JOINT_POSITION, MAX_JOINT_VELOCITY, MAX_EFFORT = 2 * np.pi, 100.0, 1000.0
"""Bounds of the arm's observed joints [rad], [rad/s], [N m], far outside of its limits; observations are clipped."""


def environment_spec(options: EnvironmentOptions) -> gym.envs.registration.EnvSpec:
    """Returns the specification from which `gymnasium.make` makes an equal environment; JSON-serialisable."""
    category = CATEGORIES[options.category]
    spec = copy.deepcopy(gym.spec(category.dense_id if options.is_dense else category.keyframe_id))
    values, defaults = options.to_json(), EnvironmentOptions(options.category).to_json()
    spec.kwargs |= {name: value for name, value in values.items() if value != defaults[name]}
    return spec


def action_space(options: EnvironmentOptions) -> gym.Space[Any]:
    """Returns the space of actions: see `ACTION_NAMES`; a key frame is a pose."""
    low = np.array([*DEFAULT_MOTION.reach_lower, *[-1.0] * 6, 0.0], np.float32)
    high = np.array([*DEFAULT_MOTION.reach_upper, *[1.0] * 6, 1.0], np.float32)
    if options.is_dense and options.action == EE_DELTA:
        return gym.spaces.Box(-1.0, 1.0, (len(ACTION_NAMES[EE_DELTA]),), np.float32)
    if options.is_dense and options.action == JOINT:
        joints = [MAX_JOINT_POSITION] * NUM_JOINTS
        low, high = np.array([*np.negative(joints), 0.0], np.float32), np.array([*joints, 1.0], np.float32)
    return gym.spaces.Box(low, high, dtype=np.float32)


def observation_space(options: EnvironmentOptions) -> gym.spaces.Dict:
    """Returns the space of observations. ``observe_images`` must be resolved."""
    joints = [*[MAX_JOINT_POSITION] * NUM_JOINTS, *[MAX_JOINT_VELOCITY] * NUM_JOINTS]
    # A cloud without points is zeros, also where the workspace does not contain the origin.
    lower, upper = np.minimum(options.workspace.lower, 0.0), np.maximum(options.workspace.upper, 0.0)
    bounds = {"agent_pos": (np.r_[POSE_LOW, np.negative(joints)], np.r_[POSE_HIGH, joints])}
    if options.is_dense and options.state == POSE:
        high = np.array([2.0, 2.0, 2.0, *[2 * np.pi] * 3, 2 * FINGER_TRAVEL, 2 * FINGER_TRAVEL])
        bounds["agent_pos"] = (-high, high)
    if options.observes_effort:
        bounds["effort"] = (np.full(NUM_JOINTS, -MAX_EFFORT), np.full(NUM_JOINTS, MAX_EFFORT))
    if options.memory == EVENTS:
        largest = np.full(len(MEMORY_NAMES), MAX_MOTION)
        bounds["environment_state"] = (-largest, largest)
    if options.observes_cloud:
        bounds["point_cloud"] = (np.tile(lower, (options.num_points, 1)), np.tile(upper, (options.num_points, 1)))
    spaces: dict[str, gym.Space[Any]] = {
        key: gym.spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        for key, (low, high) in bounds.items()
    }
    if options.observe_images:
        picture = gym.spaces.Box(0, 255, (options.image_size, options.image_size, 3), np.uint8)
        spaces["pixels"] = gym.spaces.Dict(dict.fromkeys(options.observed_cameras, picture))
    return gym.spaces.Dict(spaces)


def reset_options(environment: EnvironmentOptions, seed: int | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a reset's options for the simulator; raises `ConfigurationError` for a wrong name, object, type or seed.

    Gymnasium refuses negative seeds, and those of another type.
    """
    if isinstance(seed, int) and seed > MAX_SEED:
        raise ConfigurationError("Seed too large.", got=seed, allowed=f"0 ... {MAX_SEED}", hint="env.reset(seed=1000)")
    for name in options:
        require_choice("option of a reset", name, RESET_OPTIONS)
    chosen = {name: value for name, value in options.items() if name != NEW_ROLLOUT}
    overrides = chosen.get("hidden_overrides")
    if overrides is not None and not isinstance(overrides, Mapping):
        raise ConfigurationError(
            "Wrong hidden values of a reset.",
            got=repr(overrides),
            allowed="a mapping from name to value",
            hint="options={'hidden_overrides': {'locked': True}}",
        )
    object_id = chosen.get("object_id")
    if object_id is None:
        return chosen
    if select_objects(environment.category, str(object_id), environment.assets) != (object_id,):
        raise ConfigurationError(
            "Not one object.", got=repr(object_id), allowed="the id of one object", hint="'safe_002'"
        )
    return chosen
