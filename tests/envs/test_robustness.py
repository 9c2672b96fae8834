"""Nonsense neither crashes nor explodes, in any category; malformed actions are refused with a helpful error."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from check_common import check_scenes
from envs_helpers import at_once_or_at_night
from numpy.typing import NDArray

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.rotations import rotation_6d_from_matrix, rotation_about
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.errors import ConfigurationError

pytestmark = pytest.mark.sim
MAX_JOINT_SPEED = 3.0
"""Joint speed of an unstable simulation [rad/s]. A Panda's limits are 2.175 to 2.61."""
SLACK = 0.1
"""Distance of an object's joint beyond its limits that counts as broken [rad or m]."""
MALFORMED = (
    np.full(ACTION_DIM, np.nan), np.r_[np.zeros(ACTION_DIM - 1), np.inf], np.zeros(ACTION_DIM - 1),
    np.zeros((1, ACTION_DIM)),
)  # fmt: skip


def actions(rng: np.random.Generator) -> Iterator[NDArray[np.float32]]:
    """A random key frame in the workspace, and two of four kinds that have the right shape and make no sense."""
    position = rng.uniform((0.2, -0.4, 0.3), (0.8, 0.4, 1.0))
    rotation = rotation_about(rng.normal(size=3), rng.uniform(0, np.pi))
    yield np.asarray([*position, *rotation_6d_from_matrix(rotation), rng.choice([0.0, 1.0])], np.float32)
    wild = (
        np.full(ACTION_DIM, rng.choice([1e6, -3e38]), np.float32),
        np.full(ACTION_DIM, rng.choice([0.0, 1e-40]), np.float32),
        np.asarray([0.5, 0.0, 0.7, *[1.0, 0, 0] * 2, -5.0], np.float32),  # parallel rows are not a rotation
        (10 * rng.normal(size=ACTION_DIM)).astype(np.float32),
    )
    yield from wild[rng.integers(2) :: 2]


def check(task: Any, seed: int) -> list[str]:
    """Runs one seed in a task and returns the problems."""
    task.reset(seed=seed, options={"reconfigure": True})
    wrong = []
    for action in actions(np.random.default_rng(seed)):
        feedback = task.execute(action)
        wrong += [
            f"seed {seed}, action {np.array2string(action, precision=3)}: {text}" for text in broken(task, feedback)
        ]
    for malformed in MALFORMED:
        with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:"):
            task.execute(malformed)
    return wrong


def broken(task: Any, feedback: Any) -> Iterator[str]:
    simulation, positions = task.simulation, task.simulation.joint_positions()
    arm = simulation.arm_state()
    numbers = (feedback.tcp_in_base, arm.qpos, arm.qvel, task.driver.effort, np.array(list(positions.values())))
    if not all(np.isfinite(values).all() for values in numbers):
        yield "not finite"
        return
    if np.abs(feedback.tcp_in_base[:3, 3]).max() > 1.5:
        yield f"the hand is at {feedback.tcp_in_base[:3, 3]}"
    if np.abs(arm.qvel).max() > MAX_JOINT_SPEED:
        yield f"a joint of the arm moves at {np.abs(arm.qvel).max():.1f} rad/s"
    for name, position in positions.items():
        lower, upper = simulation.obj.joint(name).limits
        if not lower - SLACK <= position <= upper + SLACK:
            yield f"{name} is at {position:.3f}, limits {lower:.3f} ... {upper:.3f}"
    beyond = any(abs(positions[name]) > goal for name, goal in simulation.mechanism.goals.items())
    if task.evaluate()["success"].item() != beyond:
        yield "success disagrees with the mechanism"


@at_once_or_at_night("category", CATEGORIES, ("safe",))
def test_random_wild_and_malformed_actions_do_no_harm(category: str) -> None:
    seeds = (1, 2) if category == "safe" else range(7_000_000, 7_000_010)
    problems = check_scenes(category, seeds, check)
    assert problems
    assert not any(problems)
