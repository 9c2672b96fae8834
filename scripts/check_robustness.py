"""Sends invalid actions to every environment. Reports crashes, unstable simulations and accepted malformed actions.

For every seed, it first sends random key frames in the workspace, with the hand open and closed. Then follow wild ones
(huge, zero, out of reach, degenerate rotations) and malformed ones (not a number, wrong shape). Malformed ones must be
refused with a helpful error. Example: ``python scripts/check_robustness.py --category all --seeds 100 --workers 2``.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from check_common import header, parser, run_seeds
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import rotation_6d_from_matrix, rotation_about
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.util.errors import ConfigurationError, UnreachableError

RANDOM_ACTIONS = 1
MAX_JOINT_SPEED = 3.0
"""Joint speed of an unstable simulation [rad/s]. A Panda's limits are 2.175 to 2.61."""
SLACK = 0.1
"""Distance of an object's joint beyond its limits that counts as broken [rad or m]."""


def random_actions(rng: np.random.Generator) -> Iterator[NDArray[np.float32]]:
    """Yields random key frames in the workspace: any position, any rotation, hand open or closed."""
    for _ in range(RANDOM_ACTIONS):
        position = rng.uniform((0.2, -0.4, 0.3), (0.8, 0.4, 1.0))
        rotation = rotation_about(rng.normal(size=3), rng.uniform(0, np.pi))
        pose = [*position, *rotation_6d_from_matrix(rotation), rng.choice([0.0, 1.0])]
        yield np.asarray(pose, np.float32)


def wild_actions(rng: np.random.Generator) -> Iterator[NDArray[np.float32]]:
    """Yields finite actions of the right shape that make no sense: two of four kinds."""
    yield from list(_wild(rng))[rng.integers(2) :: 2]


def _wild(rng: np.random.Generator) -> Iterator[NDArray[np.float32]]:
    yield np.full(ACTION_DIM, rng.choice([1e6, -3e38]), np.float32)
    yield np.full(ACTION_DIM, rng.choice([0.0, 1e-40]), np.float32)
    yield np.asarray([0.5, 0.0, 0.7, *[1.0, 0, 0] * 2, -5.0], np.float32)  # parallel rows are not a rotation
    yield (10 * rng.normal(size=ACTION_DIM)).astype(np.float32)


def malformed_actions() -> Iterator[Any]:
    """Yields actions that must be refused."""
    yield np.full(ACTION_DIM, np.nan)
    yield np.r_[np.zeros(ACTION_DIM - 1), np.inf]
    yield np.zeros(ACTION_DIM - 1)
    yield np.zeros((1, ACTION_DIM))


def through(env: Any, seed: int) -> list[str]:
    """Runs one seed in a task and returns the problems."""
    env.reset(seed=seed, options={"reconfigure": True})
    rng, wrong = np.random.default_rng(seed), []
    for action in (*random_actions(rng), *wild_actions(rng)):
        felt = env.execute(action)
        wrong += [f"seed {seed}, action {np.array2string(action, precision=3)}: {each}" for each in _broken(env, felt)]
    for action in malformed_actions():
        try:
            env.execute(action)
        except ConfigurationError as error:
            if not all(word in str(error) for word in ("got:", "allowed:", "try:")):
                wrong.append(f"seed {seed}: unclear error {error}")
        else:
            wrong.append(f"seed {seed}: malformed action {action!r} was not refused")
    return wrong


def _broken(env: Any, felt: Any) -> Iterator[str]:
    arm = env.simulation.arm_state()
    numbers = (
        felt.tcp_in_base,
        arm.qpos,
        arm.qvel,
        env.driver.effort,
        np.array(list(env.simulation.joint_positions().values())),
    )
    if not all(np.isfinite(each).all() for each in numbers):
        yield "not finite"
        return
    if np.abs(felt.tcp_in_base[:3, 3]).max() > 1.5:
        yield f"the hand is at {felt.tcp_in_base[:3, 3]}"
    if np.abs(arm.qvel).max() > MAX_JOINT_SPEED:
        yield f"a joint of the arm moves at {np.abs(arm.qvel).max():.1f} rad/s"
    positions = env.simulation.joint_positions()
    for name, position in positions.items():
        lower, upper = env.simulation.obj.joint(name).limits
        if not lower - SLACK <= position <= upper + SLACK:
            yield f"{name} is at {position:.3f}, limits {lower:.3f} ... {upper:.3f}"
    beyond = any(abs(positions[name]) > goal for name, goal in env.simulation.mechanism.goals.items())
    if env.evaluate()["success"].item() != beyond:
        yield "success disagrees with the mechanism"


def check(category: str, seeds: list[int]) -> list[dict[str, Any]]:
    """Runs seeds of a category in one simulator. Returns the problems of each, and whether it could be placed."""
    warnings.filterwarnings("ignore")
    from lerobot_env_adamanip.simulator import make_task

    env, found = make_task(category), []
    try:
        for seed in seeds:
            result: dict[str, Any] = {"category": category, "seed": seed, "placed": True, "wrong": []}
            try:
                result["wrong"] = through(env, seed)
            except UnreachableError:
                result["placed"] = False
            found.append(result)
    finally:
        env.close()
    return found


def main() -> int:
    """Parses, runs, prints. Returns 0 without problems."""
    options = parser(__doc__, seeds=100, first_seed=7_000_000).parse_args()
    found, lines = run_seeds(check, options), []
    for name, results in found.items():
        wrong = [text for each in results for text in each["wrong"]]
        unplaced = sum(not each["placed"] for each in results)
        lines += [f"{name:16} {len(results):5} seeds, {unplaced} not placed, {len(wrong)} wrong", *wrong]
    results = [each for part in found.values() for each in part]
    sys.stdout.write((json.dumps({**header(), "results": results}) if options.json else "\n".join(lines)) + "\n")
    return 1 if any(each["wrong"] for each in results) else 0


if __name__ == "__main__":
    sys.exit(main())
