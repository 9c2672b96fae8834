"""The robot's memory of felt tries: computed from what the recorder stores, and new in each episode."""

from __future__ import annotations

import numpy as np
import pytest
from felt_worlds import DOWN

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import ACTION_NAMES, DENSE, EE_DELTA, POSE, STATES
from lerobot_adamanip.contract.memory import MEMORY, MEMORY_NAMES, memory_feature
from lerobot_adamanip.contract.rotations import pose_vector, transform
from lerobot_adamanip.episode.memory import Memory, stored_memory
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.features import ARM
from lerobot_adamanip.hardware.robot_registry import RobotSession
from lerobot_adamanip.lerobot_patches.durable_recording import with_robot_columns

FPS = 10


@pytest.fixture
def session() -> RobotSession:
    return RobotSession(action=EE_DELTA, state=POSE, memory=Memory(control=DENSE, action=EE_DELTA, fps=FPS))


def reading(height: float, gripper: float) -> ArmReading:
    pose = transform((0.5, 0.0, height), DOWN)
    zeros = np.zeros(7)
    return ArmReading(0.0, 0.0, pose, gripper, zeros, zeros, zeros, ArmMode.IDLE)


def held_back(session: RobotSession) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Pulls at a grasped part in vain; returns memories, states and executed actions."""
    seen, states, executed = [], [], []
    for step in range(8):
        arm = reading(0.3, 0.3 if step > 1 else 1.0)
        numbers = session.observe(arm, step / FPS)
        seen.append(np.array([numbers[name] for name in MEMORY_NAMES], np.float32))
        states.append(np.array([numbers[name] for name in STATES[POSE]], np.float32))
        lift = 0.03 if step > 2 else 0.0
        sent = pose_vector(transform((0.5, 0.0, 0.3 + lift), DOWN), 0.0 if step else 1.0)
        session.act(sent, arm)
        executed.append(session.rows.find(states[-1])[schema.EXECUTED])
    return seen, states, executed


def test_what_a_robot_observes_is_what_its_recording_gives(session: RobotSession) -> None:
    seen, states, executed = held_back(session)
    stored = stored_memory(np.stack(states), np.stack(executed), Memory(control=DENSE, action=EE_DELTA, fps=FPS))
    for numbers, (again, _) in zip(seen, stored, strict=True):
        assert numbers.tobytes() == again.tobytes()
    assert [bool(numbers.any()) for numbers in seen[-3:]] == [False, True, True]
    assert seen[-1][MEMORY_NAMES.index("try_1.blocked.pos")] == 1


def test_an_episode_starts_without_the_tries_of_the_one_before(session: RobotSession) -> None:
    assert held_back(session)[0][-1].any()
    session.episodes += 1
    assert not held_back(session)[0][0].any()


def test_without_a_memory_nothing_is_added() -> None:
    session = RobotSession(action=EE_DELTA, state=POSE)
    assert not set(MEMORY_NAMES) & set(session.observe(reading(0.3, 1.0), 0.0))


def test_a_recording_has_the_memory_in_a_column_of_its_own() -> None:
    """LeRobot puts all numbers of a robot into its state, where no policy of ours would know it."""
    names = [*STATES[POSE], *MEMORY_NAMES]
    offered = {
        schema.STATE: {"dtype": "float32", "shape": (len(names),), "names": names},
        schema.ACTION: {"dtype": "float32", "shape": (7,), "names": list(ACTION_NAMES[EE_DELTA])},
    }
    features = with_robot_columns(offered)
    assert features[schema.STATE]["names"] == list(STATES[POSE])
    assert features[schema.STATE]["shape"] == (len(STATES[POSE]),)
    assert features[MEMORY] == memory_feature()
    assert ARM in features
