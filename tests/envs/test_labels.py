"""Labels of key frames in the simulator: an adaptive episode of each category, and what its record says of it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from envs_helpers import at_once_or_at_night

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import KeyFrameLabels, Phase
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

pytestmark = pytest.mark.sim

HIDDEN = {
    "safe": {"locked": True, "direction": 1}, "microwave": {"locked": True}, "lamp": {"mode": 2},
}  # fmt: skip


def adaptive_rows(env: KeyframeEnv, category: str, seed: int) -> list[tuple[Phase, KeyFrameLabels]]:
    """Phase and labels of an episode that starts locked, or with the expert's first direction wrong."""
    hidden = HIDDEN.get(category, {"direction": 1})
    env.reset(seed=seed, options={"hidden_overrides": hidden})
    expert = make_expert(category, "adaptive", env.annotations, generator=np.random.default_rng(seed))
    rows, goal = [], next(expert, None)
    while goal is not None:
        _, _, terminated, truncated, _ = env.step(goal.action())
        rows.append((goal.phase, env.labels))
        try:
            goal = None if terminated or truncated else expert.send(env.feedback)
        except StopIteration:
            goal = None
    return rows


@at_once_or_at_night("category", CATEGORIES, ("safe", "lamp"))
def test_an_adaptive_episode_is_labelled_and_recorded_as_it_went(envs: Any, category: str) -> None:
    env = envs(category)
    rows: list[tuple[Phase, KeyFrameLabels]] = []
    for seed in range(3, 11):  # until its guess is wrong
        rows += adaptive_rows(env, category, seed)
        if any(labels.failed for _, labels in rows):
            break
    # A spring pushes the microwave's button back against the hand that leaves it.
    returns = [labels for phase, labels in rows if phase is Phase.RELEASE and labels.tried >= 0]
    assert all((labels.tried, labels.direction, labels.failed) == (1, -1, False) for labels in returns)
    assert not returns or category == "microwave"
    tries = {phase for phase, labels in rows if labels.tried >= 0} - {Phase.RELEASE}
    assert tries <= {Phase.TRY, Phase.UNLOCK, Phase.OPEN}
    assert all(labels.tried >= 0 for phase, labels in rows if phase is Phase.UNLOCK)
    assert any(labels.failed for _, labels in rows), "an expert that knows nothing fails once in eight episodes"
    record = EpisodeRecord.from_json(env.episode_record())
    last = [labels for _, labels in rows[-record.key_frames :]]
    assert record.success
    assert last[0].trial == 0
    assert all(after.trial - before.trial >= 0 for before, after in itertools.pairwise(last))
    assert record.failed_tries <= last[-1].trial + last[-1].failed
    tried = [(joint, direction) for joint, direction, _ in record.try_sequence]
    labelled = [(labels.tried, labels.direction) for labels in last if labels.tried >= 0]
    assert [key for key, _ in itertools.groupby(labelled)] == [
        key for key, _ in itertools.groupby(tried) if key in labelled
    ]
    assert (record.split, record.object_split) == ("test", "seen")
    assert record.provenance.run_id is None
