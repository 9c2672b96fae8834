"""Labels of key frames in the simulator: an adaptive episode of each category, and what its record says of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from envs_helpers import at_once_or_at_night

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import KeyFrameLabels, Outcome, Phase
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim

HIDDEN = {
    "safe": {"locked": True, "direction": 1}, "microwave": {"locked": True}, "lamp": {"mode": 2},
}  # fmt: skip
Row = tuple[Phase, Outcome | None, KeyFrameLabels]


def adaptive_rows(env: KeyframeEnv, category: str, seed: int) -> list[Row]:
    """Phase, outcome and labels of an episode that starts locked, or with the expert's first direction wrong."""
    hidden = HIDDEN.get(category, {"direction": 1})
    env.reset(seed=seed, options={"hidden_overrides": hidden})
    expert = make_expert(category, "adaptive", env.annotations, generator=np.random.default_rng(seed))
    rows, goal = [], next(expert, None)
    while goal is not None:
        _, _, terminated, truncated, _ = env.step(goal.action())
        rows.append((goal.phase, env.feedback.outcome, env.labels))
        try:
            goal = None if terminated or truncated else expert.send(env.feedback)
        except StopIteration:
            goal = None
    return rows


@at_once_or_at_night("category", CATEGORIES, ("safe", "lamp"))
def test_an_adaptive_episode_is_labelled_as_it_went(envs: Any, category: str) -> None:
    env = envs(category)
    rows = [row for seed in (3, 4) for row in adaptive_rows(env, category, seed)]
    obj = make_object(env.episode_record()["object_id"])
    still = [{"revolute": 0.02, "prismatic": 0.002}[obj.joint(name).kind] for name in make_mechanism(obj).joints]
    tries = [(phase, outcome, labels) for phase, outcome, labels in rows if labels.tried >= 0]
    assert {phase for phase, _, _ in tries} <= {Phase.TRY, Phase.UNLOCK, Phase.OPEN}
    assert all(labels.tried >= 0 for phase, _, labels in rows if phase in (Phase.TRY, Phase.UNLOCK))
    for _, outcome, labels in tries:
        if outcome is Outcome.STALLED and abs(labels.progress) < still[labels.tried]:
            assert labels.failed
        if outcome is Outcome.REACHED:
            assert not labels.failed
    assert any(labels.failed for _, _, labels in tries), "somebody who knows nothing fails once in two episodes"
    check_record(EpisodeRecord.from_json(env.episode_record()), rows)


def check_record(record: EpisodeRecord, rows: list[Row]) -> None:
    """The record and the labels of its rows (those of the last episode) tell the same."""
    last = rows[-record.key_frames :]
    assert record.success
    assert [labels.trial for _, _, labels in last] == [
        sum(labels.failed for _, _, labels in last[:k]) for k in range(len(last))
    ]
    tries = [labels for _, _, labels in last if labels.tried >= 0]
    assert record.tries == len(tries)
    assert record.failed_tries == sum(labels.failed for labels in tries)
    assert record.blocked_pulls == sum(labels.failed for labels in tries if labels.tried == 0)
    assert (record.split, record.object_split) == ("test", "seen")
    assert record.provenance.run_id is None


def test_a_turn_that_ends_at_the_stop_with_most_of_its_way_covered_is_no_failure(envs: Any) -> None:
    env = envs("safe")
    stopped = []
    for seed in (3, 4, 5):
        rows = adaptive_rows(env, "safe", seed)
        stopped += [labels for phase, outcome, labels in rows if (phase, outcome) == (Phase.UNLOCK, Outcome.STALLED)]
    followed = [labels for labels in stopped if labels.progress > np.deg2rad(25)]
    assert followed
    assert not any(labels.failed for labels in followed)
