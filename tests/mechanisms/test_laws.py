"""What a hand can feel: force opens nothing, a key does for good, and hidden states are alike until they are tried."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ideal_joints import CAP, LAMP, LEVER, MICROWAVE, SAFE, TRAVEL, TURN_LOCKS, UPPER, Joints, limits_after, play

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.mechanisms import Mechanism, make_mechanism

some = settings(max_examples=40, deadline=None)
SHUT = (0.0, 0.0)


@dataclass(frozen=True)
class Shut:
    """An episode that begins shut: its key frees the final joint at a share ``release`` of ``reach``, signed."""

    mechanism: Mechanism[Any]
    hidden: Joints
    reach: float
    release: float
    upper: float = UPPER

    def at(self, key: float, final: float = 0.0) -> Joints:
        """Positions, by the key's share of its reach."""
        return dict(zip(self.mechanism.joints, (final, key * self.reach), strict=True))

    def after(self, *positions: Joints) -> tuple[float, float]:
        return limits_after(self.mechanism, self.hidden, *positions)[self.mechanism.joints[0]]


EPISODES = {
    "safe": Shut(SAFE, {"locked": True, "direction": -1, "knob_range": 1.4}, -1.4, 0.85),
    "turn locks": Shut(TURN_LOCKS, {"locked": True, "direction": 1, "knob_range": 1.4}, 1.4, 0.85),
    "microwave": Shut(MICROWAVE, {"locked": True}, TRAVEL, 0.7),
    "cap": Shut(CAP, {"direction": 1, "turn_range": 2.0}, 2.0, 0.85, 0.05),
    "lever": Shut(LEVER, {"direction": -1, "turn_range": 0.9}, -0.9, 0.85, 1.57),
}
every_shut = pytest.mark.parametrize("episode", EPISODES.values(), ids=EPISODES)
wishes = st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), max_size=10)


@every_shut
@given(st.lists(st.floats(-10, 10), min_size=1, max_size=8), st.floats(-0.99, 0.99))
@some
def test_what_is_shut_never_opens_by_force(episode: Shut, pulls: list[float], part: float) -> None:
    for number in range(len(pulls)):
        assert episode.after(*(episode.at(part * episode.release, pull) for pull in pulls[: number + 1])) == SHUT
    assert episode.after(*[episode.at(math.nan, math.nan)] * 3) == SHUT, "a reading that is no number opens nothing"


@every_shut
def test_the_key_frees_it_at_its_fraction_and_for_good(episode: Shut) -> None:
    before, past = episode.at(0.999 * episode.release), episode.at(1.001 * episode.release)
    assert episode.after(before) == SHUT
    assert episode.after(past) == (0.0, episode.upper)
    assert episode.after(past, {}, episode.at(0.0, 0.5), {}, before) == (0.0, episode.upper)


@every_shut
@given(wishes)
@some
def test_a_limit_never_shrinks_and_the_key_s_tells_nothing(episode: Shut, pairs: list[tuple[float, float]]) -> None:
    positions = [episode.at(*pair) for pair in pairs]
    assert (limits := [episode.after(*positions[:n]) for n in range(len(pairs) + 1)]) == sorted(limits)
    key = limits_after(episode.mechanism, episode.hidden, *positions)[episode.mechanism.joints[1]]
    assert key == (min(0.0, episode.reach), max(0.0, episode.reach))
    turns = [joints[episode.mechanism.joints[1]] for joints in play(episode.mechanism, episode.hidden, positions)]
    assert all(0.0 <= turn / episode.reach <= 1.0 for turn in turns)


@every_shut
def test_the_key_and_then_a_pull_is_success_and_neither_alone(episode: Shut) -> None:
    def last(*wishes: Joints) -> bool:
        return episode.mechanism.succeeded(play(episode.mechanism, episode.hidden, wishes)[-1])

    assert not last(episode.at(9.0, 9.0)), "not in one: it was shut"
    assert not last(episode.at(9.0))
    assert last(episode.at(9.0), episode.at(9.0, 9.0))
    if "direction" in episode.hidden:
        assert not last(episode.at(-9.0), episode.at(-9.0, 9.0))


@pytest.mark.parametrize("name", ["safe", "microwave"])
@given(wishes)
@some
def test_locked_and_unlocked_feel_the_same_until_a_pull(name: str, pairs: list[tuple[float, float]]) -> None:
    episode = EPISODES[name]
    both = [episode.hidden, {**episode.hidden, "locked": False}]
    not_pulled = [episode.at(key, -abs(final)) for key, final in pairs]
    little = [episode.at(0.5 * min(1.0, abs(key))) for key, _ in pairs]
    assert play(episode.mechanism, both[0], not_pulled) == play(episode.mechanism, both[1], not_pulled)
    locked, unlocked = (play(episode.mechanism, hidden, [*little, episode.at(0.0, 0.5)]) for hidden in both)
    assert locked[:-1] == unlocked[:-1]
    assert locked[-1] != unlocked[-1]


@pytest.mark.parametrize("name", ["safe", "turn locks", "cap", "lever"])
@given(wishes)
@some
def test_directions_feel_the_same_until_the_key_is_turned(name: str, pairs: list[tuple[float, float]]) -> None:
    episode = EPISODES[name]
    turned = [*(episode.at(0.0, final) for _, final in pairs), episode.at(0.2)]
    one, other = (play(episode.mechanism, {**episode.hidden, "direction": way}, turned) for way in (-1, 1))
    assert one[:-1] == other[:-1]
    assert one[-1] != other[-1]


@pytest.mark.parametrize("name", ["safe", "cap", "lever"])
@given(wishes)
@some
def test_ranges_feel_the_same_until_the_shorter_releases(name: str, pairs: list[tuple[float, float]]) -> None:
    episode = EPISODES[name]
    key = episode.mechanism.hidden_names[-1]
    hidden = [{**episode.hidden, key: share * abs(episode.reach)} for share in (0.93, 1.0)]
    gentle = [episode.at(0.93 * 0.84 * turn / 3.0, final) for turn, final in pairs]
    between = 0.93 * 0.88
    pulled = [*gentle, episode.at(between), episode.at(between, 0.5 * episode.upper)]
    short, long = (play(episode.mechanism, each, pulled) for each in hidden)
    assert short[:-1] == long[:-1], "a turn alone does not tell that it is enough"
    assert short[-1] != long[-1]


def test_turning_locks_only_a_shut_door_that_was_not_locked_and_only_in_upstream_s_safe() -> None:
    locked = EPISODES["turn locks"]
    unlocked = Shut(TURN_LOCKS, {**locked.hidden, "locked": False}, 1.4, 0.85)
    assert unlocked.after(unlocked.at(0.14)) == (0.0, UPPER)
    assert unlocked.after(unlocked.at(0.16)) == SHUT
    assert unlocked.after(unlocked.at(0.16), unlocked.at(1.0), {}, unlocked.at(0.0, 1.0)) == SHUT
    assert unlocked.after(unlocked.at(0.16, 0.3), unlocked.at(0.0, 0.3)) == (0.0, UPPER)
    assert locked.after(locked.at(0.16), locked.at(1.0)) == (0.0, UPPER)
    assert Shut(SAFE, unlocked.hidden, 1.4, 0.85).after(unlocked.at(1.0), unlocked.at(0.16)) == (0.0, UPPER)
    for preset in ("paper", "upstream", "hard"):
        mechanism = make_mechanism(make_object("safe_000"), preset)
        door = limits_after(mechanism, {"locked": False, "direction": 1}, {"knob": 0.3})["door"]
        assert (door == SHUT) is ("locks it" in mechanism.rules()["thresholds"]) is (preset == "upstream")


FREE = {0: ("button", (0.0, 0.022)), 1: ("knob", (0.0, 1.4)), 2: ("knob", (-1.4, 0.0))}
modes = st.sampled_from([0, 1, 2])


@given(
    st.lists(st.fixed_dictionaries({"button": st.floats(-0.1, 0.1), "knob": st.floats(-3, 3)}), max_size=10),
    modes,
    modes,
)
@some
def test_one_motion_of_a_lamp_is_free_and_shows_only_when_it_is_tried(
    sequence: list[dict[str, float]], one: int, other: int
) -> None:
    for number in range(len(sequence) + 1):
        joint, limits = FREE[one]
        assert limits_after(LAMP, {"mode": one}, *sequence[:number]) == {"button": SHUT, "knob": SHUT, joint: limits}
    third = ({0, 1, 2} - {one, other}).pop()
    joint, (lower, _) = FREE[third]
    tried = [{joint: math.copysign(wish[joint], -1 if lower < 0 else 1)} for wish in sequence]
    seen = [play(LAMP, {"mode": mode}, tried) for mode in (one, other)]
    assert seen[0] == seen[1]
    assert not any(LAMP.succeeded(joints) for joints in seen[0])
    for mode in {one, other}:
        name, (low, high) = FREE[mode]
        assert LAMP.succeeded(play(LAMP, {"mode": mode}, [*tried, {name: low + high}])[-1])
