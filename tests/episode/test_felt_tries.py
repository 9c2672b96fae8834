"""Felt tries of hands that move by hand-written rules, at key frames and at control rate."""

from __future__ import annotations

import numpy as np
import pytest
from felt_worlds import Stream
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.contract.control import DENSE, EE_DELTA, RATES
from lerobot_adamanip.contract.memory import MEMORY_NAMES, NUM_TRIES, SO_FAR, TRY_NAMES
from lerobot_adamanip.episode.felt_tries import FELT_SHARE, FREE_SHARE
from lerobot_adamanip.episode.memory import Memory, stored_memory

PULL, PUSH, LEFT = (0.0, 0.0, -0.06), (0.0, 0.0, 0.06), -0.5


@pytest.fixture
def hand() -> Stream:
    """A hand at key frames that holds a part."""
    stream = Stream(Memory())
    stream.grasps()
    return stream


@pytest.fixture
def dense() -> Stream:
    """The same at 10 Hz."""
    stream = Stream(Memory(control=DENSE, action=EE_DELTA, fps=10), is_dense=True)
    stream.grasps()
    return stream


def test_nothing_is_remembered_before_the_first_try(hand: Stream) -> None:
    hand.opens()
    hand.sends((0.0, 0.1, 0.0), share=1.0, opens=True)
    hand.grasps()
    assert not hand.memory.numbers().any()
    assert hand.memory.sentence() == ""


def test_a_blocked_pull_is_felt_with_its_place_command_and_result(hand: Stream) -> None:
    place = hand.pose[:3, 3]
    hand.sends(PULL, share=0.1)
    row = dict(zip(TRY_NAMES, hand.memory.numbers(), strict=False))
    assert [row["is_try"], row["blocked"], row["times"]] == [1, 1, 0.25]
    np.testing.assert_allclose([row["x"], row["y"], row["z"]], place, atol=1e-6)
    np.testing.assert_allclose([row["commanded_z"], row["measured_z"]], [-1.2, -0.12], atol=1e-4)
    assert hand.memory.sentence() == f"{SO_FAR}pulled: blocked."


def test_words_come_from_the_motion_and_equal_tries_are_counted(hand: Stream) -> None:
    for _ in range(3):
        hand.sends(turn=LEFT, share=0.05)
    hand.sends(turn=-LEFT, share=1.0)
    hand.sends(PULL, share=0.1)
    hand.sends((0.0, -0.04, 0.0), share=1.0)
    assert hand.memory.sentence() == (
        f"{SO_FAR}turned left 3 times: blocked; turned right: moved; pulled: blocked; moved left: moved."
    )
    hand.sends(turn=LEFT, share=0.05)
    assert hand.memory.sentence().endswith("moved left: moved; turned left 4 times: blocked.")
    assert hand.memory.numbers()[TRY_NAMES.index("times")] == 1.0


def test_a_part_that_is_pulled_on_and_on_is_one_try_that_moves(hand: Stream) -> None:
    hand.sends(PULL, share=0.05)
    for _ in range(3):
        hand.sends((0.0, 0.0, -0.1), share=1.0)
    assert hand.memory.sentence() == f"{SO_FAR}pulled: blocked; pulled 3 times: moved."


def test_the_memory_holds_the_latest_tries_newest_first(hand: Stream) -> None:
    for place in range(NUM_TRIES + 1):
        hand.sends(PULL, share=0.1)
        hand.opens()
        hand.sends((0.1, 0.0, 0.0), share=1.0, opens=True)
        hand.grasps()
        heights = hand.memory.numbers().reshape(NUM_TRIES, -1)[:, TRY_NAMES.index("x")]
        assert np.count_nonzero(heights) == min(place + 1, NUM_TRIES)
    assert (np.diff(heights) < 0).all()
    assert len(hand.memory.numbers()) == len(MEMORY_NAMES)
    hand.memory.reset()
    assert not hand.memory.numbers().any()


@pytest.mark.parametrize(("share", "felt"), [(1.0, False), (FREE_SHARE - 0.1, True), (0.05, True)])
def test_an_empty_hand_feels_only_what_holds_it_back(share: float, felt: bool) -> None:
    stream = Stream(Memory())
    stream.grasps(gripper=0.0)
    stream.sends(PULL, share=0.05)
    assert not stream.memory.events, "an empty hand cannot pull"
    stream.sends(PUSH, share=share)
    assert bool(stream.memory.events) is felt


def test_at_control_rate_one_stroke_is_one_try(dense: Stream) -> None:
    for _ in range(6):
        dense.sends((0.0, 0.0, -0.02), share=0.7)
    assert not dense.memory.events, "it goes on"
    dense.sends(share=1.0)
    (event,) = dense.memory.events
    assert (event.blocked, event.times) == (False, 1)
    assert event.measured[2] < -1.5


def test_a_hand_that_is_held_back_feels_it_while_it_pushes(dense: Stream) -> None:
    felt = []
    for _ in range(5):
        dense.sends((0.0, 0.0, -0.03), share=0.02)
        felt.append(len(dense.memory.events))
    assert felt == [0, 0, 1, 1, 1]
    assert dense.memory.events[0].blocked
    dense.sends(turn=LEFT, share=0.02)
    assert dense.memory.sentence() == f"{SO_FAR}pulled: blocked."


def test_a_small_stroke_is_no_try_neither_while_it_pushes_nor_later(dense: Stream) -> None:
    for _ in range(5):
        dense.sends((0.0, 0.0, -0.0045), share=0.02)
        assert not dense.memory.events
    dense.opens()
    assert not dense.memory.events


def test_a_hand_that_still_moves_the_other_way_is_not_held_back(dense: Stream) -> None:
    """A motion that settles says nothing about the object: the try begins when the hand obeys or stands still."""
    for _ in range(5):
        dense.sends((0.0, 0.0, -0.01), share=-0.6)
    dense.sends(share=1.0)
    assert not dense.memory.events
    for _ in range(5):
        dense.sends((0.0, 0.0, -0.01), share=0.7)
    dense.sends(share=1.0)
    assert [(event.blocked, event.times) for event in dense.memory.events] == [(False, 1)]


@pytest.mark.parametrize("fps", RATES)
@pytest.mark.parametrize("steps", [1, 2, 4, 8])
@pytest.mark.parametrize("turns", [False, True])
def test_an_arm_that_follows_a_far_command_as_fast_as_it_can_is_not_blocked(fps: int, steps: int, turns: bool) -> None:
    """An empty hand that goes forward feels nothing; what a holding hand moves is never blocked."""
    speed, acceleration, unit = (1.6, 5.0, 0.5) if turns else (0.45, 1.2, 0.1)
    times = np.arange(steps + 1) / fps
    rise = np.minimum(times, speed / acceleration)
    moved = np.diff(acceleration * rise**2 / 2 + speed * (times - rise))
    for gripper in (0.0, 0.3):
        stream = Stream(Memory(control=DENSE, action=EE_DELTA, fps=fps), is_dense=True)
        stream.grasps(gripper)
        for way in moved:
            shift, turn = ((0.0, 0.0, 0.0), unit) if turns else ((0.0, 0.0, unit), 0.0)
            stream.sends(shift, turn, share=way / unit)
            assert not any(event.blocked for event in stream.memory.events)
        stream.opens()
        assert not any(event.blocked for event in stream.memory.events)
        assert gripper or not stream.memory.events


@pytest.mark.parametrize("fps", RATES)
def test_a_short_pull_that_only_stretches_fingers_is_blocked(fps: int) -> None:
    """An expert's pull: commands up to 4.4 cm within 0.2 s. The hand moves by 6 mm, because the fingers give way."""
    stream = Stream(Memory(control=DENSE, action=EE_DELTA, fps=fps), is_dense=True)
    stream.grasps()
    steps = max(1, round(0.2 * fps))
    for step in range(steps):
        stream.sends((0.0, 0.0, -0.044 * (step + 1) / steps), share=0.006 / 0.044 / steps)
    stream.opens()
    assert [event.blocked for event in stream.memory.events] == [True]


def test_a_hand_at_rest_tries_nothing(dense: Stream) -> None:
    for _ in range(20):
        dense.sends((0.0, 0.0, -0.001), share=0.0)
    dense.opens()
    assert not dense.memory.events


@given(st.lists(st.tuples(st.sampled_from(["pull", "turn", "open", "grasp"]), st.floats(0.0, 1.0)), max_size=12))
def test_a_stored_stream_gives_the_same_memory_to_the_bit(course: list[tuple[str, float]]) -> None:
    """What is computed from the rows of an episode is what was remembered while it went on."""
    for is_dense in (False, True):
        control = {"control": DENSE, "action": EE_DELTA, "fps": 10} if is_dense else {}
        stream = Stream(Memory(**control), is_dense=is_dense)
        seen = [(stream.memory.numbers(), stream.memory.sentence())]
        for what, share in course:
            if what in ("open", "grasp"):
                (stream.opens if what == "open" else stream.grasps)()
            else:
                stream.sends(PULL if what == "pull" else (0, 0, 0), LEFT if what == "turn" else 0.0, share=share)
            seen.append((stream.memory.numbers(), stream.memory.sentence()))
        actions = np.stack([*stream.actions, stream.actions[-1]]) if stream.actions else np.zeros((1, 10), np.float32)
        stored = list(stored_memory(np.stack(stream.states), actions, Memory(**control)))
        for (numbers, sentence), (again, words) in zip(seen, stored, strict=True):
            assert numbers.tobytes() == again.tobytes()
            assert sentence == words


def test_the_border_between_blocked_and_moved_is_a_share(hand: Stream) -> None:
    hand.sends(PULL, share=FELT_SHARE - 0.01)
    hand.sends((0.06, 0.0, 0.0), share=FELT_SHARE + 0.01)
    assert [event.blocked for event in hand.memory.events] == [False, True]
