"""Which ticks are key frames, and which accepted target each of them ended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dense_helpers import STOPS, WALL, Stop, dense_episode, jumped
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.recordings.keyframe_choice import DenseEpisode, choose_key_frames
from lerobot_adamanip.util.errors import DatasetError

FPS = 30


def goals(stops: tuple[Stop, ...] = STOPS) -> np.ndarray:
    return np.stack([stop.goal for stop in stops[1:]])


def test_actions_are_the_goals_that_a_person_stopped_at() -> None:
    episode = dense_episode()
    chosen = choose_key_frames(episode, FPS)
    np.testing.assert_array_equal(chosen.actions[:-1], goals())
    np.testing.assert_array_equal(chosen.actions[:-1], episode.sent[chosen.accepted])
    stalled = [Outcome.STALLED if stop.position[0] > WALL else Outcome.REACHED for stop in STOPS[1:]]
    assert chosen.outcomes.tolist() == [*stalled, Outcome.REACHED]


def test_a_row_is_observed_where_the_key_frame_before_it_ended() -> None:
    episode = dense_episode()
    chosen = choose_key_frames(episode, FPS)
    for row, stop in zip(chosen.rows, STOPS, strict=True):
        reached = np.minimum(stop.position, (WALL, 1.0, 1.0))
        assert np.linalg.norm(episode.state[row, :3] - reached) < 0.012
        assert abs(episode.state[row, 9] - stop.gripper) < 0.1
    # A target belongs to the key frame that it is accepted after.
    assert (chosen.accepted > chosen.rows[:-1]).all()
    assert (chosen.accepted <= chosen.rows[1:]).all()


def test_the_last_row_stays_where_the_tool_is() -> None:
    episode = dense_episode()
    chosen = choose_key_frames(episode, FPS)
    np.testing.assert_array_equal(chosen.actions[-1, :9], episode.state[chosen.rows[-1], :9])
    assert chosen.rows[-1] == len(episode) - 1


@example([(1, 0, False, 8), (0, 0, True, 8), (1, 0, True, 8), (0, 0, False, 8)], 0)  # there, and back again
@settings(max_examples=15, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 3), st.integers(-2, 2), st.booleans(), st.integers(8, 20)), min_size=1, max_size=5
    ),
    st.integers(0, 2**31),
)
def test_any_stops_are_found(places: list[tuple[int, int, bool, int]], seed: int) -> None:
    stops = [Stop((0.35, 0.0, 0.7))]
    for x, y, is_open, rest in places:
        stop = Stop((0.4 + 0.05 * x, 0.08 * y, 0.7), 0.0, float(is_open), rest)
        # Hands close where they are, as experts' do: on the way, a change of the gripper is a key frame of its own.
        if stop.gripper != stops[-1].gripper:
            stops.append(stops[-1]._replace(gripper=stop.gripper, rest=10))
        if stop.position != stops[-1].position:
            stops.append(stop)
    if len(stops) < 2:
        return
    chosen = choose_key_frames(dense_episode(stops, seed=seed), FPS)
    np.testing.assert_array_equal(chosen.actions[:-1], goals(tuple(stops)))


def test_a_goal_that_jumps_is_found_as_well() -> None:
    """Key frames that are sent whole: the next goal is accepted while the arm still stands."""
    chosen = choose_key_frames(dense_episode(how=jumped), FPS)
    np.testing.assert_array_equal(chosen.actions[:-1], goals())


def test_readings_told_twice_are_no_stop() -> None:
    episode = dense_episode()
    twice = np.repeat(np.arange(len(episode)), 2)
    chosen = choose_key_frames(episode.take(twice), 2 * FPS)
    np.testing.assert_array_equal(chosen.actions[:-1], goals())


def test_what_the_arm_says_of_its_motions_counts() -> None:
    episode = replace(dense_episode(), outcome=np.full(len(dense_episode()), int(Outcome.TIMEOUT)))
    assert set(choose_key_frames(episode, FPS).outcomes[:-1].tolist()) == {int(Outcome.TIMEOUT)}


def test_stamps_that_stand_still_give_way_to_the_rate() -> None:
    episode = replace(dense_episode(), stamp=np.zeros(len(dense_episode())))
    np.testing.assert_array_equal(choose_key_frames(episode, FPS).actions[:-1], goals())


def test_an_episode_without_motion_is_refused() -> None:
    still: DenseEpisode = dense_episode((Stop((0.4, 0.0, 0.7), rest=30),))
    with pytest.raises(DatasetError, match="stays in one place"):
        choose_key_frames(still, FPS)
