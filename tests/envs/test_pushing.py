"""In the simulator: what a hand pushes gives way whatever its fingers do, and what it grazes does not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.keyframes import PRE_GRASP, Goal, Phase
from lerobot_adamanip.contract.rotations import transform
from lerobot_env_adamanip.sim.arm_driver import FINGER_CLOSED, FINGER_OPEN

pytestmark = pytest.mark.sim
TURNS = ({"direction": 1, "turn_range": 0.9}, {"direction": -1, "turn_range": 0.6})


@pytest.fixture
def task(category: str, tasks: Any) -> Any:
    return tasks(category)


def reset(task: Any, seed: int, **hidden: Any) -> None:
    task.reset(seed=seed, options={"hidden_overrides": hidden, "reconfigure": True})


def go(task: Any, pose: Any, gripper: float) -> None:
    task.execute(Goal(pose, gripper, Phase.APPROACH).action())


@pytest.mark.parametrize("category", ["microwave"])
@pytest.mark.parametrize(("gripper", "with_one_finger"), [(0.0, 0), (0.3, 0), (0.49, 1), (0.55, 1), (1.0, -1)])
def test_a_button_is_pushed_with_any_part_of_the_hand(
    task: Any, category: str, gripper: float, with_one_finger: int
) -> None:
    reset(task, 5, locked=True)
    beside = with_one_finger * (FINGER_CLOSED + (FINGER_OPEN - FINGER_CLOSED) * gripper)
    at = task.placement.annotations["button"].grasp @ transform((0.0, beside, 0.0))
    go(task, at @ transform((0.0, 0.0, -PRE_GRASP)), 1.0)
    go(task, at @ transform((0.0, 0.0, -0.03)), gripper)
    assert not task.simulation.tries.tries
    go(task, at @ transform((0.0, 0.0, 0.03)), gripper)
    (made,) = task.simulation.tries.tries
    assert (task.simulation.mechanism.joints[made.joint], made.direction, made.failed) == ("button", 1, False)
    assert task.simulation.joint_positions()["button"] > 0.8 * task.simulation.obj.joint("button").limits[1]
    assert task.simulation.joint_positions()["door"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("category", "part"), [("door", "lever"), ("window", "handle")])
@pytest.mark.parametrize("grippers", [(0.55, 0.55), (1.0, 0.0)])
def test_a_lever_is_turned_by_an_open_hand_and_by_one_that_closes_meanwhile(
    task: Any, category: str, part: str, grippers: tuple[float, float]
) -> None:
    reset(task, 4, **TURNS[0])
    lever = task.placement.annotations[part]
    turn = next(motion for motion in lever.motions if motion.joint == part)
    go(task, lever.grasp @ transform((0.0, 0.0, -PRE_GRASP)), 1.0)
    go(task, lever.grasp, 1.0)
    go(task, lever.grasp, grippers[0])
    assert not task.simulation.tries.tries
    go(task, turn.applied(lever.grasp, 0.3), grippers[1])
    assert task.simulation.joint_positions()[part] > 0.1
    assert {task.simulation.mechanism.joints[made.joint] for made in task.simulation.tries.tries} == {part}


@pytest.mark.parametrize(("category", "part"), [("door", "lever"), ("window", "handle")])
def test_an_approach_that_grazes_or_hits_a_part_moves_and_tells_nothing(task: Any, category: str, part: str) -> None:
    for beside in (-0.03, 0.03):
        for begins in (0.0, beside):  # oblique, straight
            ends = []
            for hidden in TURNS:
                reset(task, 4, **hidden)
                grasp = task.placement.annotations[part].grasp
                go(task, grasp @ transform((0.0, begins, -PRE_GRASP)), 1.0)
                go(task, grasp @ transform((0.0, beside, 0.0)), 1.0)
                assert not task.simulation.tries.tries
                ends.append(
                    np.concatenate([task.simulation.arm_state().qpos, list(task.simulation.joint_positions().values())])
                )
            assert ends[0].tobytes() == ends[1].tobytes()
