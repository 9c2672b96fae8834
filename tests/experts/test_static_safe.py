"""The static expert goes straight there; and neither expert is built with what it must not have or lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import KinematicWorld, adaptive, as_bytes, placed_parts, run, static

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.rotations import pose_from_vector, rotation_about, transform
from lerobot_adamanip.experts import Feedback, Goal, Outcome, Phase, make_expert
from lerobot_adamanip.experts.doors import PULL_ANGLES
from lerobot_adamanip.util.errors import ConfigurationError

fast = settings(max_examples=25, deadline=None)
seeds = st.integers(0, 2**31)
ids = st.integers(0, 60).map(lambda number: object_id("safe", number))
hiddens = st.fixed_dictionaries({"locked": st.booleans(), "direction": st.sampled_from([-1, 1])})


@fast
@given(ids, hiddens, seeds)
def test_it_goes_straight_there(name: str, hidden: dict[str, Any], seed: int) -> None:
    safe = KinematicWorld(name, hidden, layout=seed)
    episode = run(safe, static(safe, seed))
    assert episode.opened > 0.95 * PULL_ANGLES[-1]
    assert episode.failed_pulls() == 0
    assert episode.phases.count(Phase.GRASP) == 1 + hidden["locked"]
    assert {sign for sign, _ in episode.turns()} == ({hidden["direction"]} if hidden["locked"] else set())


@fast
@given(ids, hiddens, seeds)
def test_it_needs_no_more_key_frames_than_trial_and_error(name: str, hidden: dict[str, Any], seed: int) -> None:
    one, other = KinematicWorld(name, hidden), KinematicWorld(name, hidden)
    straight, tried = run(one, static(one)), run(other, adaptive(other, seed))
    assert len(straight.goals) + 3 * hidden["locked"] <= len(tried.goals)


@fast
@given(ids, hiddens, seeds, seeds)
def test_it_leaves_nothing_but_the_approach_to_chance(
    name: str, hidden: dict[str, Any], first: int, second: int
) -> None:
    safes = KinematicWorld(name, hidden), KinematicWorld(name, hidden)
    episodes = [run(safe, static(safe, seed)) for safe, seed in zip(safes, (first, second), strict=True)]
    one, other = ([goal for goal in episode.goals if goal.phase is not Phase.APPROACH] for episode in episodes)
    assert as_bytes(one) == as_bytes(other)


def build(category: str = "safe", kind: str = "adaptive", **options: Any) -> None:
    make_expert(category, kind, placed_parts(make_object("safe_000")), generator=np.random.default_rng(0), **options)


@pytest.mark.parametrize(
    "options",
    [
        {"kind": "adaptive", "hidden": {"locked": True, "direction": 1}}, {"kind": "static"},
        {"kind": "adaptive", "trials": 0}, {"kind": "adaptive", "trials": -3}, {"kind": "clairvoyant"},
        {"category": "fridge"},
    ],
)  # fmt: skip
def test_an_expert_with_the_wrong_knowledge_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        build(**options)
    assert all(word in str(caught.value) for word in ("got:", "allowed:", "try:"))


def test_a_goal_says_its_pose_in_the_contract_s_words() -> None:
    pose = transform((0.4, -0.1, 0.6), rotation_about((1, 2, 3), 0.7))
    action = Goal(pose, 0.5, Phase.TRY).action()
    assert action.shape == (10,)
    assert action.dtype == np.float32
    back, gripper = pose_from_vector(action)
    np.testing.assert_allclose(back, pose, atol=1e-6)
    assert gripper == 0.5


@pytest.mark.parametrize("outcome", [None, *Outcome])
def test_only_arriving_and_not_having_gone_are_no_failure(outcome: Outcome | None) -> None:
    assert Feedback(np.eye(4), 1.0, outcome).failed == (outcome not in (None, Outcome.REACHED))
