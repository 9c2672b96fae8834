"""A policy drives and an expert corrects it: what is recorded, what is remembered, and what a reader makes of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import demos_fake_env
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from demos_helpers import corrected, make_spec, patiently, same_bytes

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.corrections import Correcting, corrected_rollout
from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.episode.rollout import KeyFrame
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.inputs import read_recorded_rows

POLICY = "0123456789abcdef" * 2
Refuses = Callable[[type, Callable[[], Any]], str]


def spec(**changes: Any) -> CollectionSpec:
    return make_spec(**{"policy": POLICY, "expert_share": 0.4, "observe_images": False, "late_starts": 0.3, **changes})


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("mixed") / "dataset"
    collect(root, spec(), corrected(), patiently())
    return root


def rows(root: Path, key: str) -> np.ndarray:
    table = pq.read_table(sorted((root / "data").glob("*/*.parquet"))).sort_by("index")
    return np.asarray(table[key].to_pylist())


def driven(share: float, seed: int = 4) -> tuple[list[KeyFrame], demos_fake_env.FakeActor]:
    env, seen, actor = demos_fake_env.make_env(spec().environment), [], demos_fake_env.FakeActor()
    observation, _ = env.reset(seed=seed, options={"object_id": "safe_000", "hidden_overrides": {"locked": True}})

    def take_over(*, belief: Any, generator: np.random.Generator) -> Any:
        positions, feedback = env.part_positions(), env.feedback
        known = {"positions": positions, "feedback": feedback, "belief": belief, "generator": generator}
        return demos_fake_env.make_expert("safe", "adaptive", {}, **known)

    corrected_rollout(
        env, observation, Correcting(actor, take_over, share, seed, np.random.default_rng(seed)), seen.append
    )
    return seen, actor


def test_what_is_sent_is_the_policys_and_what_is_recorded_the_experts() -> None:
    seen, actor = driven(0.0)
    assert len(seen) == demos_fake_env.FakeEnv.max_key_frames
    assert all(np.array_equal(frame.executed, mine) for frame, mine in zip(seen, actor.remembered, strict=True))
    assert not any(np.array_equal(frame.executed, frame.goal.action()) for frame in seen)
    assert actor.told == []


def test_an_expert_that_drives_alone_opens_it_and_the_policy_remembers_what_was_done() -> None:
    seen, actor = driven(1.0)
    assert [frame.goal.phase.name for frame in seen] == ["TRY", "UNLOCK", "TRY"]
    assert seen[-1].success
    assert all(np.array_equal(frame.executed, frame.goal.action()) for frame in seen)
    assert all(np.array_equal(one, other) for one, other in zip(actor.remembered, actor.told, strict=True))


def test_the_expert_believes_what_the_policy_has_tried() -> None:
    seen, _ = driven(0.0)
    tried = [frame.labels.failed for frame in seen]
    first = tried.index(True)
    assert seen[first].goal.phase.name == "TRY"
    assert seen[first + 1].goal.phase.name == "UNLOCK"


def test_episodes_are_kept_whether_they_succeed_or_not_and_replay_exactly(mixed: Path) -> None:
    outcomes = Dataset(mixed).table["success"].to_pylist()
    assert len(outcomes) == 6
    sent, corrections = rows(mixed, schema.EXECUTED), rows(mixed, schema.ACTION)
    assert 0.2 < (sent == corrections).all(axis=1).mean() < 0.9
    for episode in range(3):
        result = replay(mixed, episode, demos_fake_env.make_env)
        assert result.agrees(0.0), result


def test_workers_and_interruptions_change_nothing(tmp_path: Path, mixed: Path) -> None:
    root = tmp_path / mixed.name
    collect(root, spec(), corrected(), patiently(workers=2))
    same_bytes(mixed, root)


def test_a_policys_history_is_what_was_executed_and_its_labels_are_the_corrections(mixed: Path) -> None:
    recorded = read_recorded_rows(open_dataset(mixed).meta)
    sent, corrections = rows(mixed, schema.EXECUTED), rows(mixed, schema.ACTION)
    differ = np.abs(sent - corrections).max(axis=1) > 1e-6
    frame = rows(mixed, "frame_index")
    inside = [row for row in range(2, len(sent) - 1) if frame[row] > 1 and frame[row + 1]]
    now = next(row for row in inside if differ[row - 2 : row].any())
    place = recorded.rows(torch.tensor([now]))
    (before, _), (ahead, _) = recorded.around(place, (-2, -1)), recorded.around(place, (0, 1))
    past, future = sent[now - 2 : now], corrections[now : now + 2]
    for columns, key, expected in ((before, schema.EXECUTED, past), (ahead, schema.ACTION, future)):
        np.testing.assert_array_equal(recorded.column(key, columns)[0].numpy(), expected.astype(np.float32))


@pytest.mark.parametrize(
    "wrong", [{"policy": "", "expert_share": 0.3}, {"expert_share": 1.5}, {"expert": "static"}], ids=str
)
def test_what_does_not_go_together_is_refused(wrong: dict[str, Any], refuses: Refuses) -> None:
    refuses(ConfigurationError, lambda: spec(**wrong))


def test_an_episode_ends_just_past_success(monkeypatch: pytest.MonkeyPatch) -> None:
    """Made anew at each key frame, an expert may never find that it has nothing left to do."""
    monkeypatch.setattr(demos_fake_env, "OPEN_AT", 0.55)
    made = demos_fake_env._corrections

    def tireless(belief: Any, positions: Any, feedback: Any) -> Any:
        return made(belief, {"lid": 0.0}, feedback)

    monkeypatch.setattr(demos_fake_env, "_corrections", tireless)
    seen, _ = driven(1.0)
    assert [frame.success for frame in seen] == [False, False, True, True]
