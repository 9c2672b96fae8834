"""How much work a control tick asks of the physics engine, against a fake of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_env_adamanip.sim.control_tick import FREE_ITERATIONS, GRIP_TICKS, Closing, ControlTick


class Joint:
    def __init__(self) -> None:
        self.position = self.velocity = np.nan

    def set_drive_target(self, position: float) -> None:
        self.position = position

    def set_drive_velocity_target(self, velocity: float) -> None:
        self.velocity = velocity


class World:
    """Nine joints, three links; ``near`` says in which steps something is about the arm before they are taken."""

    def __init__(self, near: dict[int, list[Any]]) -> None:
        self.active_joints = [Joint() for _ in range(9)]
        self.links = [object() for _ in range(3)]
        self.near, self.iterations, self.taken = near, 40, list[int]()

    def get_solver_position_iterations(self) -> int:
        return 40

    def set_solver_position_iterations(self, iterations: int) -> None:
        self.iterations = iterations

    def get_contacts(self) -> list[Any]:
        return [SimpleNamespace(bodies=bodies) for bodies in self.near.get(len(self.taken), [])]

    def step(self) -> None:
        self.taken.append(self.iterations)

    def ticks(self, number: int) -> list[int]:
        control: Any = ControlTick(self, self, steps=4)  # type: ignore[arg-type]
        for _ in range(number):
            control.run(np.arange(7.0), np.ones(7), 0.02)
        return self.taken


def test_an_arm_that_touches_nothing_is_cheap() -> None:
    assert World({}).ticks(2) == [FREE_ITERATIONS] * 8


def test_the_first_step_with_a_contact_has_all_iterations_and_so_has_the_rest_of_the_tick() -> None:
    world = World({})
    world.near = {2: [(world.links[1], object())]}
    assert world.ticks(2) == [FREE_ITERATIONS] * 2 + [40] * 2 + [FREE_ITERATIONS] * 4


@pytest.mark.parametrize("side", [0, 1])
def test_a_contact_counts_whichever_body_is_named_first(side: int) -> None:
    world = World({})
    bodies = [object(), object()]
    bodies[side] = world.links[0]
    world.near = {key: [bodies] for key in range(8)}
    assert world.ticks(2) == [40] * 8


def test_contacts_of_others_are_none_of_the_arm() -> None:
    assert World({key: [(object(), object())] for key in range(4)}).ticks(1) == [FREE_ITERATIONS] * 4


def test_every_joint_is_told_where_to_go() -> None:
    world = World({})
    world.ticks(1)
    assert [joint.position for joint in world.active_joints] == [*range(7), 0.02, 0.02]
    assert [joint.velocity for joint in world.active_joints[:7]] == [1.0] * 7


def test_fingers_close_around_a_part_while_their_target_falls_and_a_moment_longer_if_the_arm_stays() -> None:
    closing, arm = Closing(), np.zeros(7)
    assert not closing.update(arm, 0.04), "nothing is known of before"
    assert [closing.update(arm, 0.04 - 0.004 * k) for k in range(1, 4)] == [True] * 3
    assert [closing.update(arm, 0.028) for _ in range(GRIP_TICKS + 3)] == [True] * (GRIP_TICKS - 1) + [False] * 4
    closing.update(arm, 0.02)
    assert not closing.update(arm + 0.01, 0.016), "the arm moves"
