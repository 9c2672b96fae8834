"""The ManiSkill task itself: plain use, the mechanism under force, and experts at work."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from lerobot_adamanip.contract.keyframes import Goal
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.experts import Outcome, Phase, make_expert
from lerobot_adamanip.objects.safe import DOOR_UPPER
from lerobot_adamanip.util.errors import ConfigurationError

pytestmark = pytest.mark.sim
SAFE = "AdaManip-Safe-v1"
OPENED = np.pi / 7


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    import lerobot_env_adamanip.sim.tasks  # noqa: F401  (registers the tasks)

    made: Any = gym.make(SAFE, obs_mode="none", reward_mode="none").unwrapped
    yield made
    made.close()


def reset(env: Any, seed: int, *, object_id: str | None = None, **hidden: Any) -> None:
    env.reset(seed=seed, options={"object_id": object_id, "hidden_overrides": hidden})


def play(env: Any, kind: str) -> list[tuple[Goal, Outcome, float]]:
    """Runs an expert until the safe is open: goal, outcome and joint speed of each key frame."""
    hidden = env.hidden_state() if kind == "static" else None
    expert = make_expert("safe", kind, env.placement.annotations, generator=np.random.default_rng(0), hidden=hidden)
    done, goal = [], next(expert)
    while len(done) < 45:
        felt = env.execute(goal.action())
        assert felt.outcome is not None
        done.append((goal, felt.outcome, float(np.abs(env.arm_state().qvel).max())))
        if env.evaluate()["success"][0]:
            break
        try:
            goal = expert.send(felt)
        except StopIteration:
            break
    return done


# Experts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("locked", [True, False])
@pytest.mark.parametrize("kind", ["adaptive", pytest.param("static", marks=pytest.mark.nightly)])
def test_experts_open_seen_and_unseen_safes(env: Any, kind: str, locked: bool) -> None:
    for number in (0, 21, 50):
        reset(env, 900 + number, object_id=f"safe_{number:03d}", locked=locked)
        frames = play(env, kind)
        story = [(goal.phase.name, outcome.name) for goal, outcome, _ in frames]
        assert env.joint_positions()["door"] > OPENED, (number, story)
        tries = [outcome for goal, outcome, _ in frames if goal.phase is Phase.TRY]
        turned = any(goal.phase is Phase.UNLOCK for goal, _, _ in frames)
        assert turned is locked, (number, story)
        if kind == "adaptive":
            assert (tries[0] is Outcome.STALLED) is locked, (number, story)
        # In free space the arm is where it was sent, and still, when the key frame is over.
        free = [frame for frame in frames if frame[0].phase in (Phase.APPROACH, Phase.RELEASE)]
        assert all(outcome is Outcome.REACHED and speed < 0.04 for _, outcome, speed in free), (number, story)


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
        assert np.isfinite(env.effort).all()
        assert abs(np.degrees(env.joint_positions()["door"])) < 1.0
    assert not env.evaluate()["success"][0]


@pytest.mark.parametrize("direction", [1, -1])
def test_the_knob_turns_one_way_to_its_end_and_frees_the_door(env: Any, direction: int) -> None:
    reset(env, 43, locked=True, direction=direction)
    limit, slack = env.hidden_state()["knob_range"], np.deg2rad(1.5)
    assert limit <= env.obj.joint("knob").limits[1]
    knob = grasp(env, "knob")
    blocked = env.execute(Goal(knob.moved({"knob": -direction * np.deg2rad(40)}), 0.0, Phase.UNLOCK).action())
    assert blocked.outcome is Outcome.STALLED
    assert -slack < direction * env.joint_positions()["knob"] < slack
    assert env.mechanism.step(env.mechanism_driver.state, env.joint_positions())[1]["door"] == (0.0, 0.0)
    for turn in (40, 80, 120, 160):
        env.execute(Goal(knob.moved({"knob": direction * np.deg2rad(turn)}), 0.0, Phase.UNLOCK).action())
        assert -slack < direction * env.joint_positions()["knob"] < limit + slack
    assert direction * env.joint_positions()["knob"] > 0.85 * limit
    assert env.mechanism.step(env.mechanism_driver.state, env.joint_positions())[1]["door"][1] == pytest.approx(
        DOOR_UPPER
    )


# Plain ManiSkill --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("obs_mode", "control_mode"),
    [
        ("pointcloud", "pd_ee_delta_pose"),
        ("rgb", "pd_joint_pos"),
        ("state", "pd_ee_delta_pose"),
        ("state", "pd_joint_pos"),
    ],
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
        assert set(made.unwrapped.evaluate()) == {"success", "door", "knob"}
        assert made.unwrapped.evaluate()["success"].shape == (1,)
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
        arm = made.unwrapped.arm_state()
        np.testing.assert_allclose(seen[1][0, :7].numpy(), arm.qpos, atol=1e-6)
    finally:
        made.close()


def test_sparse_reward_is_one_while_open(env: Any) -> None:
    reset(env, 901, locked=False)
    before = env.compute_sparse_reward(None, None, env.evaluate())
    play(env, "adaptive")
    after = env.compute_sparse_reward(None, None, env.evaluate())
    assert (before.item(), after.item()) == (0.0, 1.0)


@pytest.mark.parametrize("wrong", [{"num_envs": 2}, {"sim_backend": "gpu"}, {"poses": "x"}, {"objects": "x"}])
def test_what_cannot_work_is_refused(env: Any, wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:"):
        gym.make(SAFE, **wrong)
