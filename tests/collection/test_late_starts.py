"""Late starts: decided by the seed alone, no success yet, and repeated by a replay."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from demos_fake_env import FakeEnv
from demos_helpers import fakes, make_spec

from lerobot_adamanip.collection.late_starts import (
    KEY_FRAMES,
    draw_start,
    start_late,
)
from lerobot_adamanip.collection.record import EpisodeRequest, attempt_episode
from lerobot_adamanip.contract.rotations import angle_between
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.episode import RESET, read_start, start_column
from lerobot_adamanip.util.errors import UnreachableError


def late_seed(share: float = 0.5, start: int = 0) -> int:
    for seed in range(start, start + 500):
        env = fakes().environment(make_spec().environment_of("safe"))
        try:
            env.reset(seed=seed, options={"object_id": "safe_000"})
        except UnreachableError:
            continue
        if draw_start(seed, "safe", share) is not None:
            return seed
    raise AssertionError("no seed starts late")


def test_the_share_that_is_asked_for_starts_late_and_more_asked_for_only_adds() -> None:
    before: set[int] = set()
    for share in (0.0, 0.15, 0.6, 1.0):
        late = {seed for seed in range(2000) if draw_start(seed, "safe", share) is not None}
        assert len(late) / 2000 == pytest.approx(share, abs=0.03)
        assert before <= late
        before = late


def test_a_seed_is_a_start() -> None:
    one, other = draw_start(7, "safe", 1.0), draw_start(7, "safe", 1.0)
    assert one is not None
    assert other is not None
    np.testing.assert_array_equal(one.move, other.move)
    assert one.key_frames == other.key_frames
    drawn = [start for seed in range(300) if (start := draw_start(seed, "safe", 1.0))]
    assert {start.key_frames for start in drawn} == set(range(KEY_FRAMES[0], KEY_FRAMES[1] + 1))
    assert all(start.move[2, 3] < -0.04 for start in drawn)  # away from the part
    assert all(angle_between(start.move[:3, :3], np.eye(3)) < 0.6 for start in drawn)


def test_it_ends_with_open_fingers_away_from_the_part_and_short_of_success() -> None:
    env = fakes().environment(make_spec().environment_of("safe"))
    assert isinstance(env, FakeEnv)
    seed = late_seed()
    start = draw_start(seed, "safe", 1.0)
    assert start is not None

    def reset() -> object:
        return env.reset(seed=seed, options={"object_id": "safe_000"})[0]

    def expert(generator: np.random.Generator) -> object:
        return fakes().expert("safe", "static", {}, generator=generator, hidden=env.hidden_state())

    _, actions = start_late(env, start, reset, expert)  # type: ignore[arg-type]
    assert not env.opened
    assert (env.steps, env.tries, env.labels.trial) == (0, [], 0), "counting starts with the recording"
    assert (actions[-2:, GRIPPER_DIM] == 1.0).all()
    np.testing.assert_array_equal(actions[-2, :3], actions[-3, :3])  # the fingers open where they are
    assert np.linalg.norm(actions[-1, :3] - actions[-2, :3]) > 0.04
    content = start_column(actions)
    np.testing.assert_array_equal(read_start(content), actions)


def test_what_is_recorded_begins_there_and_counts_from_there() -> None:
    spec, seed = make_spec(late_starts=1.0), late_seed(1.0)
    env = fakes().environment(spec.environment_of("safe"))
    for number in range(seed, seed + 40):
        try:
            attempt, episode = attempt_episode(env, spec, fakes().expert, EpisodeRequest("safe_000", number))
        except UnreachableError:
            continue
        assert attempt.late
        prefix = read_start(episode.record["start"])
        assert len(episode) == attempt.key_frames + 1
        assert episode.record["episode_record"]["key_frames"] == attempt.key_frames
        np.testing.assert_allclose(episode.columns["observation.state"][0, :3], prefix[-1, :3], atol=1e-6)
        assert episode.columns["complementary_info.trial"][0, 0] == 0


def test_an_episode_from_rest_says_so(finished: Path) -> None:
    starts = [json.loads(row["start"]) for row in Dataset(finished).table.to_pylist()]
    assert RESET in starts
    assert any(start != RESET for start in starts)
    assert len(read_start(RESET)) == 0
