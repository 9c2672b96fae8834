"""What is hidden stays hidden until it is tried. The full run: ``scripts/check_hidden_state.py --seeds 100``."""

from __future__ import annotations

import contextlib
import os
from typing import Any

import check_hidden_state as script
import numpy as np
import pytest
from envs_helpers import at_once_or_at_night

from lerobot_adamanip.contract.cameras import CAMERAS
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import PRE_GRASP, Goal
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.experts import Phase, make_expert
from lerobot_env_adamanip.simulator import make_task

pytestmark = pytest.mark.sim
NO_VULKAN = "nonexistent" in os.environ.get("VK_DRIVER_FILES", "")
"""In a process that is told to find no Vulkan device clouds have to do (scripts/nightly.sh)."""
TELLTALE = {"door": (302, 307), "window": (301,)}
"""Seeds on which the joints, left free, tell the hidden state before anything is tried."""


@pytest.fixture
def task(category: str, tasks: Any) -> Any:
    return tasks(category)


@at_once_or_at_night("category", CATEGORIES, ("door", "safe"))
def test_nothing_shows_until_the_part_is_held(task: Any, category: str) -> None:
    """Every number of arm, object and observation, to the bit, in every frame; cloud and image of the held one."""
    for seed in TELLTALE.get(category, (31,)):
        first, *others = (
            script.frames_until_held(task, seed, hidden, image=not NO_VULKAN) for hidden in script.VARIANTS[category]
        )
        assert len(first) >= 4  # reset, two approaches, the grasp
        pictures = {f"raycast {name}" for name in CAMERAS}
        pictures |= set() if NO_VULKAN else {f"render {name}" for name in CAMERAS}
        assert {"cloud"} | pictures <= set(first[0]) & set(first[-1])
        for other in others:
            assert script.differences(first, other) == ()


SEVERAL_LOCKS = {
    "row": (
        {"direction": 1, "turn_range": 0.6, "second_pulls": True, "third_pulls": False},
        {"direction": -1, "turn_range": 1.0, "second_pulls": False, "third_pulls": True},
    ),
    "changing": (
        {"direction": 1, "later_direction": 1, "turn_range": 0.6, "relocks": True},
        {"direction": -1, "later_direction": 1, "turn_range": 1.0, "relocks": False},
    ),
}


@at_once_or_at_night("rules", SEVERAL_LOCKS, ("row",))
def test_nothing_shows_of_several_locks_until_the_part_is_held(rules: str) -> None:
    with contextlib.closing(make_task("door", mechanism_rules=rules)) as door:
        first, other = (
            script.frames_until_held(door, TELLTALE["door"][0], hidden, image=False) for hidden in SEVERAL_LOCKS[rules]
        )
    assert len(first) >= 4
    assert script.differences(first, other) == ()


@at_once_or_at_night("category", TELLTALE, ("door",))
def test_the_same_comparison_notices_joints_that_are_not_held(task: Any, category: str) -> None:
    task.holds_joints = False
    for seed in TELLTALE[category]:
        first, other = (
            script.frames_until_held(task, seed, hidden, look=False) for hidden in script.VARIANTS[category]
        )
        assert any("object positions" in found for found in script.differences(first, other))


@pytest.mark.parametrize("category", ["door", "lamp"])
def test_trying_tells(task: Any, category: str) -> None:
    """Held is not locked: the first motion of the closed hand ends differently under different hidden states."""
    ends = []
    for hidden in script.VARIANTS[category]:
        task.reset(seed=31, options={"hidden_overrides": hidden, "reconfigure": True})
        expert = make_expert(category, "adaptive", task.placement.annotations, generator=np.random.default_rng(0))
        goal = next(expert)
        while goal.phase in (Phase.APPROACH, Phase.GRASP):
            goal = expert.send(task.execute(goal.action()))
        assert not task.simulation.tries.tries
        ends.append(task.execute(goal.action()))
        assert task.simulation.tries.tries
    assert any(np.abs(ends[0].tcp_in_base - other.tcp_in_base).max() > 2e-3 for other in ends[1:])


@pytest.mark.parametrize("category", ["microwave"])
def test_a_joint_is_released_by_a_try_alone(task: Any, category: str) -> None:
    task.reset(seed=5, options={"hidden_overrides": {"locked": True}, "reconfigure": True})
    button, driver = task.placement.annotations["button"], task.simulation

    def go(distance: float, gripper: float) -> None:
        task.execute(Goal(button.grasp @ transform((0.0, 0.0, distance)), gripper, Phase.APPROACH).action())

    go(-PRE_GRASP, 1.0)
    for distance, gripper in ((-0.03, 1.0), (-0.03, 0.0), (-0.05, 0.0)):  # on the way, closing, closed in free air
        go(distance, gripper)
        assert not task.simulation.tries.tries
        assert driver.held == {"door", "button"}
    go(0.03, 0.0)
    assert [task.simulation.mechanism.joints[made.joint] for made in task.simulation.tries.tries] == ["button"]
    assert "door" in driver.held
    assert task.simulation.joint_positions()["button"] > 0.7 * task.simulation.obj.joint("button").limits[1]
    assert task.simulation.joint_positions()["door"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("category", ["door"])
def test_plain_maniskill_control_hides_too(task: Any, category: str) -> None:
    """Joints stay held in free air and under a graze, in each control mode; ``info`` tells success alone."""
    import gymnasium as gym

    from lerobot_adamanip.contract.categories import CATEGORIES as ALL

    for mode in ("pd_joint_delta_pos", "pd_ee_delta_pose", "pd_joint_vel"):
        ends = []
        for hidden in script.VARIANTS[category][:2]:
            env = gym.make(ALL[category].task_id, obs_mode="state", control_mode=mode, hidden_overrides=hidden)
            env.reset(seed=301)
            rng = np.random.default_rng(0)
            for _ in range(30):
                observation, *_, info = env.step(rng.uniform(-1, 1, env.action_space.shape))
            assert set(info) <= {"success", "elapsed_steps"}
            plain: Any = env.unwrapped
            ends.append((np.asarray(observation), tuple(plain.simulation.joint_positions().values())))
            env.close()
        assert ends[0][0].tobytes() == ends[1][0].tobytes()
        assert ends[0][1] == ends[1][1]
