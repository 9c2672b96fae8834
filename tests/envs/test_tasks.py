"""The ManiSkill task itself: plain use, and the mechanism under force."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from lerobot_adamanip.contract.keyframes import Goal
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.experts import Outcome, Phase
from lerobot_adamanip.objects.safe import DOOR_UPPER
from lerobot_adamanip.util.errors import ConfigurationError

pytestmark = pytest.mark.sim
SAFE = "AdaManip-Safe-v1"


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    import lerobot_env_adamanip.sim.tasks  # noqa: F401  (registers the tasks)

    made: Any = gym.make(SAFE, obs_mode="none", reward_mode="none").unwrapped
    yield made
    made.close()


def reset(env: Any, seed: int, *, object_id: str | None = None, **hidden: Any) -> None:
    env.reset(seed=seed, options={"object_id": object_id, "hidden_overrides": hidden})


# The mechanism under force ------------------------------------------------------------------------------------------


def grasp(env: Any, part: str) -> Any:
    annotation = env.placement.annotations[part]
    before = annotation.grasp @ transform((0.0, 0.0, -0.10))
    for pose, gripper in ((before, 1.0), (annotation.grasp, 1.0), (annotation.grasp, 0.0)):
        env.execute(Goal(pose, gripper, Phase.APPROACH).action())
    return annotation


@pytest.mark.parametrize("seed", [41, 42])
def test_a_lock_never_opens_by_force(env: Any, seed: int) -> None:
    reset(env, seed, locked=True)
    handle = grasp(env, "handle")
    pulls = [handle.moved({"door": np.deg2rad(angle)}) for angle in (10, 30, 45, 80, -20)]
    pulls += [handle.grasp @ transform((0.0, 0.0, -distance)) for distance in (0.05, 0.2, 0.4, -0.05, 0.3)]
    for pose in pulls:
        felt = env.execute(Goal(pose, 0.0, Phase.TRY).action())
        assert np.isfinite(felt.tcp_in_base).all()
        assert np.isfinite(env.driver.effort).all()
        assert abs(np.degrees(env.simulation.joint_positions()["door"])) < 1.0
    assert not env.evaluate()["success"][0]


@pytest.mark.parametrize("direction", [1, -1])
def test_the_knob_turns_one_way_to_its_end_and_frees_the_door(env: Any, direction: int) -> None:
    reset(env, 43, locked=True, direction=direction)
    limit, slack = env.simulation.hidden_state()["knob_range"], np.deg2rad(1.5)
    assert limit <= env.simulation.obj.joint("knob").limits[1]
    knob = grasp(env, "knob")
    blocked = env.execute(Goal(knob.moved({"knob": -direction * np.deg2rad(40)}), 0.0, Phase.UNLOCK).action())
    assert blocked.outcome is Outcome.STALLED
    assert -slack < direction * env.simulation.joint_positions()["knob"] < slack
    assert env.simulation.mechanism.step(env.simulation.state, env.simulation.joint_positions())[1]["door"] == (
        0.0,
        0.0,
    )
    for turn in (40, 80, 120, 160):
        env.execute(Goal(knob.moved({"knob": direction * np.deg2rad(turn)}), 0.0, Phase.UNLOCK).action())
        assert -slack < direction * env.simulation.joint_positions()["knob"] < limit + slack
    assert direction * env.simulation.joint_positions()["knob"] > 0.85 * limit
    assert env.simulation.mechanism.step(env.simulation.state, env.simulation.joint_positions())[1]["door"][
        1
    ] == pytest.approx(DOOR_UPPER)


# Plain ManiSkill --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("obs_mode", "control_mode"),
    [("pointcloud", "pd_ee_delta_pose"), ("rgb", "pd_joint_pos"), ("state", "pd_joint_pos")],
)
def test_plain_maniskill_use(env: Any, obs_mode: str, control_mode: str) -> None:
    made = gym.make(
        SAFE, obs_mode=obs_mode, control_mode=control_mode, reward_mode="sparse", image_size=64, sim_backend="cpu"
    )
    try:
        observation, _ = made.reset(seed=1)
        made.action_space.seed(1)
        for _ in range(3):
            observation, reward, terminated, truncated, _ = made.step(made.action_space.sample())
            assert made.observation_space.contains(observation)
            assert float(reward) == 0.0
            assert not bool(terminated)
            assert not bool(truncated)
        task: Any = made.unwrapped
        assert all(task.evaluate()[name].shape == (1,) for name in ("success",))
        task._objects.articulation.set_qpos(np.ones((1, 2), np.float32))
        assert task.compute_sparse_reward(None, None, task.evaluate()).item() == 1.0
    finally:
        made.close()


def test_maniskills_state_is_the_arm_alone() -> None:
    """Neither the object's joints nor anything hidden: flipping the hidden state changes no number of it."""
    made = gym.make(SAFE, obs_mode="state", control_mode="pd_joint_pos")
    try:
        seen = []
        for locked in (True, False):
            observation, _ = made.reset(seed=2, options={"hidden_overrides": {"locked": locked}})
            assert observation.shape == (1, 18)  # positions and velocities of seven joints and two fingers
            seen.append(observation.clone())
        assert torch.equal(*seen)
        arm = made.unwrapped.simulation.arm_state()
        np.testing.assert_allclose(seen[1][0, :7].numpy(), arm.qpos, atol=1e-6)
    finally:
        made.close()


@pytest.mark.parametrize(
    "wrong",
    [
        {"num_envs": 2}, {"sim_backend": "gpu"}, {"poses": "x"}, {"objects": "x"}, {"split": "test"},
        {"robot_uids": "fetch"}, {"obs_mode": "pointcloud", "sensing": "rough"}, {"obs_mode": "rgb", "num_points": 64},
    ],
)  # fmt: skip
def test_what_cannot_work_is_refused(env: Any, wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:"):
        gym.make(SAFE, **wrong)


@pytest.mark.parametrize("wrong", [{"object_id": "lamp_000"}, {"hidden_overrides": "locked"}])
def test_wrong_options_of_a_reset_are_refused(env: Any, wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:"):
        env.reset(seed=1, options=wrong)


def test_a_state_without_the_mechanism_cannot_be_set(env: Any) -> None:
    env.reset(seed=1)
    with pytest.raises(ConfigurationError, match="cannot be set"):
        env.set_state(env.get_state())


def test_an_arm_that_is_kept_has_as_many_solver_iterations_in_each_episode() -> None:
    made: Any = gym.make(SAFE, obs_mode="none", reconfiguration_freq=0).unwrapped
    try:
        counts = []
        for seed in (1, 2):
            made.reset(seed=seed)
            counts.append(made.agent.robot._objs[0].get_solver_position_iterations())
            made.simulation.tick(made.simulation.arm_state().qpos, np.zeros(7), 0.04)  # touches nothing: fewer
            assert made.agent.robot._objs[0].get_solver_position_iterations() < counts[0]
        assert counts[0] == counts[1]
    finally:
        made.close()
