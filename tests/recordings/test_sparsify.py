from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import pose_vector, rotation_about, transform
from lerobot_adamanip.recordings.sparsify import DenseTrajectory, distance, sparsify

RATE = 20.0


def pose(x: float, gripper: float = 1.0, angle: float = 0.0) -> NDArray[np.float64]:
    return pose_vector(transform((x, 0.0, 0.3), rotation_about((0, 0, 1), angle)), gripper).astype(np.float64)


def teleoperated(stops: list[tuple[float, float, int]]) -> NDArray[np.float64]:
    """Moves from stop to stop in steps of about 2 cm (0.4 m/s), and stays at each for some samples."""
    samples: list[NDArray[np.float64]] = []
    x, gripper = stops[0][0], stops[0][1]
    for goal, next_gripper, dwell in stops:
        steps = max(1, round(abs(goal - x) / 0.02))
        samples += [pose(x + (goal - x) * i / steps, gripper) for i in range(steps)]
        samples += [pose(goal, next_gripper)] * max(1, dwell)
        x, gripper = goal, next_gripper
    return np.stack(samples)


def trajectory_of(samples: NDArray[np.float64], command: NDArray[np.float64] | None = None) -> DenseTrajectory:
    """A sample's speed is towards the next one."""
    way = [distance(a, b) for a, b in itertools.pairwise(samples)]
    return DenseTrajectory(samples, np.array([*way, 0.0]) * RATE, samples if command is None else command)


stops = st.lists(
    st.tuples(st.integers(0, 10).map(lambda i: i / 10), st.sampled_from([0.0, 1.0]), st.integers(0, 6)),
    min_size=1,
    max_size=8,
)
jitter = st.integers(0, 2**32 - 1)


@settings(max_examples=40, deadline=None)
@given(stops, jitter, st.booleans())
def test_laws(places: list[tuple[float, float, int]], seed: int, commanded: bool) -> None:
    samples = teleoperated(places)
    generator = np.random.default_rng(seed)
    samples[:, :3] += generator.normal(scale=2e-4, size=(len(samples), 3))
    command = None
    if commanded:
        changes = np.cumsum(generator.random(len(samples)) < 0.1)
        command = np.stack([pose(x) for x in generator.random(changes[-1] + 1)])[changes]
    trajectory = trajectory_of(samples, command)
    kept = sparsify(trajectory)

    assert kept[0] == 0
    assert kept[-1] == len(samples) - 1
    assert (np.diff(kept) > 0).all()
    again = trajectory.take(kept)
    np.testing.assert_array_equal(sparsify(again), np.arange(len(kept)))
    is_open = samples[:, schema.GRIPPER_DIM] > 0.5
    assert np.count_nonzero(np.diff(is_open)) == np.count_nonzero(np.diff(is_open[kept]))
    assert len(kept) <= len(samples)


def test_a_stop_is_kept_once_and_the_way_is_not() -> None:
    samples = teleoperated([(0.0, 1.0, 5), (0.4, 1.0, 6), (0.8, 1.0, 4)])
    kept = sparsify(trajectory_of(samples))
    assert sorted({round(float(samples[t, 0]), 3) for t in kept}) == [0.0, 0.4, 0.8]
    assert len(kept) <= 4  # the first sample, and the end of every stay


def test_a_grasp_is_kept_where_the_gripper_has_settled() -> None:
    samples = np.concatenate(
        [teleoperated([(0.0, 1.0, 3), (0.4, 1.0, 4)]), np.stack([pose(0.4, g) for g in (0.8, 0.3, 0.1, 0.1)])]
    )
    samples = np.concatenate([samples, teleoperated([(0.4, 0.1, 1), (0.6, 0.1, 3)])])
    kept = sparsify(trajectory_of(samples))
    at_grasp = [float(samples[t, schema.GRIPPER_DIM]) for t in kept if round(float(samples[t, 0]), 3) == 0.4]
    assert at_grasp[-1] == pytest.approx(0.1)
    assert at_grasp[0] > 0.5  # and before it, open, in place


def test_a_gripper_that_changes_on_the_way_is_kept_there() -> None:
    samples = teleoperated([(0.0, 1.0, 3), (0.8, 1.0, 3)])
    moving = 20
    samples[moving:, schema.GRIPPER_DIM] = 0.0
    assert moving in sparsify(trajectory_of(samples))


def test_a_goal_given_up_far_from_it_is_kept() -> None:
    samples = teleoperated([(0.0, 1.0, 2), (0.6, 1.0, 2)])
    command = np.stack([pose(0.9)] * 15 + [pose(0.6)] * (len(samples) - 15))
    without = sparsify(trajectory_of(samples))
    kept = sparsify(trajectory_of(samples, command))
    assert set(kept) - set(without) == {14}


def test_a_blocked_arm_that_is_given_another_goal_stays_once_for_each() -> None:
    still = np.stack([pose(0.3)] * 20)
    away = np.stack([pose(0.3 - 0.02 * i) for i in range(1, 10)] + [pose(0.1)] * 5)
    samples = np.concatenate([still, away])
    goals = [pose(0.4)] * 8 + [pose(0.5)] * 9 + [pose(0.1)] * (len(samples) - 17)
    kept = sparsify(trajectory_of(samples, np.stack(goals)))
    # The arm leaves three samples after its second goal was given up; that is no key frame of its own.
    assert kept.tolist() == [0, 7, 16, len(samples) - 1]


def test_an_arm_that_springs_back_when_a_goal_is_given_up_stays_in_one_place() -> None:
    leans = [pose(0.291 + 0.0012 * i) for i in range(9)]  # and gives way slowly, by 24 mm/s
    still = np.stack([*leans, *[pose(0.297)] * 7])
    away = np.stack([pose(x) for x in (0.290, 0.283, 0.277, 0.272, *[0.270] * 5)])
    samples = np.concatenate([still, away])
    command = np.stack([pose(0.35)] * 8 + [pose(0.27)] * (len(samples) - 8))
    kept = sparsify(trajectory_of(samples, command))
    assert kept.tolist() == [0, 7, len(samples) - 1]


def test_a_goal_that_streams_ahead_of_the_arm_is_not_given_up() -> None:
    samples = teleoperated([(0.0, 1.0, 2), (0.6, 1.0, 2)])
    command = np.concatenate([samples[3:], samples[-1:].repeat(3, axis=0)])
    without = sparsify(trajectory_of(samples))
    np.testing.assert_array_equal(sparsify(trajectory_of(samples, command)), without)


def test_turning_on_the_spot_is_moving() -> None:
    samples = np.stack([pose(0.3, angle=a) for a in np.linspace(0.0, 1.5, 16)])
    assert sparsify(trajectory_of(samples)).tolist() == [0, 15]
    assert distance(pose(0.0), pose(0.0, angle=1.0)) == pytest.approx(0.1)
    assert distance(pose(0.0), pose(0.2, gripper=0.0)) == pytest.approx(0.2)
