"""Plans that are learnt from, and how many episodes each of them would open."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.affordance.demonstrations import MIN_CLEARANCE_M, Demonstrations, read_demonstrations
from lerobot_policy_adamanip.vat_mart.plan_labels import PlanLabels, label_plans, opened_share


@pytest.fixture
def demonstrations(toy_root: Path) -> Demonstrations:
    return read_demonstrations(SimpleNamespace(root=toy_root))


def plans(demonstrations: Demonstrations, labels: PlanLabels) -> list[tuple[slice, int]]:
    """Rows of each episode, and the plan that they lead to."""
    found = []
    for rows in demonstrations.episodes():
        (plan,) = set(labels.plan_of[demonstrations.index[rows]].tolist()) - {-1}
        found.append((rows, plan))
    return found


def test_a_plan_is_what_was_done_in_the_first_contact(demonstrations: Demonstrations) -> None:
    labels = label_plans(demonstrations, 8)
    for rows, plan in plans(demonstrations, labels):
        contact = demonstrations.contacts(rows)[0]
        sent = demonstrations.commands[contact.first : contact.end]
        np.testing.assert_array_equal(labels.grasps[plan], contact.grasp)
        np.testing.assert_array_equal(labels.waypoints[plan][: len(sent)], sent)
        assert (labels.waypoints[plan][len(sent) :] == sent[-1]).all()


def test_a_plan_that_is_too_long_is_cut(adaptive_toy_root: Path) -> None:
    tried = read_demonstrations(SimpleNamespace(root=adaptive_toy_root))
    lengths = np.array([each[0].end - each[0].first for each in map(tried.contacts, tried.episodes())])
    short = int(np.median(lengths))
    assert lengths.min() <= short < lengths.max()
    whole, cut = label_plans(tried, 16), label_plans(tried, short)
    np.testing.assert_array_equal(cut.waypoints, whole.waypoints[:, :short])
    assert (whole.share > 0).all()
    assert (cut.share[lengths > short + 1] == 0).all()  # the last key frame opens wider what the last but one opened


def test_a_plan_is_made_while_the_hand_is_open_and_away(demonstrations: Demonstrations) -> None:
    labels = label_plans(demonstrations, 8)
    for rows, plan in plans(demonstrations, labels):
        counting = np.flatnonzero(labels.plan_of[demonstrations.index[rows]] == plan) + rows.start
        assert counting[0] == rows.start
        assert counting[-1] <= demonstrations.contacts(rows)[0].start
        assert (demonstrations.poses[counting, schema.GRIPPER_DIM] > 0.5).all()
        away = np.linalg.norm(demonstrations.poses[counting, :3] - labels.grasps[plan, :3], axis=1)
        assert (away > MIN_CLEARANCE_M).all()


def test_what_another_hand_has_turned_before_is_not_the_plans(demonstrations: Demonstrations) -> None:
    rows = next(demonstrations.episodes())
    turned = 0.95 * demonstrations.joints[rows.stop - 1, 1]
    joints = demonstrations.joints.copy()
    late = joints[rows, 1]
    joints[rows, 1] = np.where(np.abs(late) < abs(turned), turned, late)
    started_late = label_plans(replace(demonstrations, joints=joints), 8)
    assert label_plans(demonstrations, 8).share[0] > 0
    assert started_late.share[0] == 0


def test_where_nothing_opens_within_one_contact_there_is_nothing_to_learn(demonstrations: Demonstrations) -> None:
    with pytest.raises(ConfigurationError, match="waypoints=16"):
        label_plans(demonstrations, 1)


def share(moved: list[list[float]], needed: list[list[float]], needed_tasks: list[int] | None = None) -> list[float]:
    plan_tasks, tasks = np.zeros(len(moved), np.int64), np.array(needed_tasks or [0] * len(needed))
    found = opened_share(np.array(moved, np.float32), plan_tasks, np.array(needed, np.float32), tasks)
    return [round(float(value), 6) for value in found]


def test_a_plan_opens_the_episodes_of_its_task_whose_motions_it_covers() -> None:
    turns = [[0.04, 0.5], [0.04, 1.0], [0.04, 1.5], [0.04, -1.0]]
    assert share([[0.04, turn] for turn in (0.0, 0.5, 1.0, 2.0, -2.0)], turns) == [0, 0.25, 0.5, 0.75, 0.25]
    assert share([[0.0, 2.0]], turns) == [0]
    # Joints that an episode did not move may have been moved.
    assert share([[0.04, 1.0], [0.04, 0.0]], [[0.04, 0.001], [0.04, 1.0]]) == [1.0, 0.5]
    assert share([[0.04, 1.0]], [[0.04, 1.0], [0.04, -1.0]], [0, 1]) == [1.0]
    assert share([[0.04, 1.0]], [[0.04, 1.0]], [1]) == [0.0]


def test_static_demonstrations_open_themselves_and_not_all(demonstrations: Demonstrations) -> None:
    """A bottle's direction is drawn: no turn opens all of them."""
    labels = label_plans(demonstrations, 8)
    ways = np.sign(demonstrations.joints[[rows.stop - 1 for rows in demonstrations.episodes()], 1])
    assert set(ways.tolist()) == {-1.0, 1.0}
    assert (labels.share >= 1 / 6).all()
    assert (labels.share < 1).all()
