"""What is hidden stays hidden until it is tried. The full run: ``scripts/check_hidden_state.py --seeds 100``."""

from __future__ import annotations

import os
from typing import Any

import check_hidden_state as script
import numpy as np
import pytest
from envs_helpers import at_once_or_at_night

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import PRE_GRASP, Goal
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.experts import Phase, make_expert

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
        assert {"cloud"} | ({"image"} if not NO_VULKAN else set()) <= set(first[-1])
        for other in others:
            assert script.differences(first, other) == ()


@at_once_or_at_night("category", TELLTALE, ("door",))
def test_the_same_comparison_notices_joints_that_are_not_held(task: Any, category: str) -> None:
    task.holds_the_untried = False
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
            assert task.mechanism_driver.untried == set(task.mechanism.joints)
            goal = expert.send(task.execute(goal.action()))
        ends.append(task.execute(goal.action()))
        assert task.mechanism_driver.untried == frozenset()
    assert any(np.abs(ends[0].tcp_in_base - other.tcp_in_base).max() > 2e-3 for other in ends[1:])


@pytest.mark.parametrize("category", ["microwave"])
def test_a_joint_is_released_by_a_closed_hand_that_touches_it(task: Any, category: str) -> None:
    task.reset(seed=5, options={"hidden_overrides": {"locked": True}, "reconfigure": True})
    button = task.placement.annotations["button"]
    held, driver = {"door", "button"}, task.mechanism_driver

    def go(distance: float, gripper: float) -> None:
        task.execute(Goal(button.grasp @ transform((0.0, 0.0, distance)), gripper, Phase.APPROACH).action())

    go(-PRE_GRASP, 1.0)
    go(-0.03, 1.0)
    assert driver.untried == held  # an open hand on its way
    go(-0.03, 0.0)
    assert driver.untried == held  # a hand that closes
    go(-0.05, 0.0)
    assert driver.untried == held  # a closed hand in free air
    go(0.03, 0.0)
    assert driver.untried == {"door"}  # a closed hand that pushes: the button alone
    assert task.joint_positions()["button"] > 0.7 * task.obj.joint("button").limits[1]
    assert task.joint_positions()["door"] == pytest.approx(0.0, abs=1e-3)
