"""What a policy would try next: every hidden state of a scene is played, and draws are counted by what has failed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import check_choices
import numpy as np
import pytest
from check_choices import Tally, flips, play

from lerobot_adamanip.contract.keyframes import KeyFrameLabels

PULL, LEFT, RIGHT = ("door", 1), ("knob", 1), ("knob", -1)


def test_a_scene_is_played_under_every_hidden_state() -> None:
    hidden = {"locked": True, "direction": 1, "knob_range": 1.2}
    found = list(flips(hidden, fixed=False))
    assert len(found) == 4
    assert {(each["locked"], each["direction"]) for each in found} == {(a, b) for a in (False, True) for b in (-1, 1)}
    assert all("knob_range" not in each for each in found), "ranges stay as drawn"
    assert list(flips({"direction": 1, "turn_range": 0.8}, fixed=True)) == [{}], "a direction that is always the same"
    assert [each["mode"] for each in flips({"mode": 2}, fixed=False)] == [0, 1, 2]


def test_draws_that_repeat_what_failed_are_counted_among_tries_and_among_all() -> None:
    tally = Tally()
    tally.add(set(), [PULL, PULL, None])
    tally.add({PULL, LEFT}, [RIGHT, RIGHT, LEFT, None])
    first, after = tally.to_json()["after"]
    assert (first["failed"], first["repeat_of_tries"]) == (0, 0)
    assert first["draws"] == {"door +": 2, "no try": 1}
    assert (after["failed"], after["repeat_of_all"]) == (2, 0.25)
    assert after["repeat_of_tries"] == pytest.approx(1 / 3, abs=1e-3)


class Stubborn:
    """Tries the same in every key frame, drawn or done."""

    def reset(self, seed: int) -> None:
        pass

    def draws(self, observation: Any, instruction: str, number: int) -> np.ndarray:
        return np.zeros((number, 10), np.float32)

    def act(self, observation: Any, instruction: str) -> np.ndarray:
        return np.zeros(10, np.float32)


class Locked:
    """An environment in which nothing gives, but for the third try."""

    max_key_frames, task_description, joint_names, labels = 6, "open it", ("door", "knob"), KeyFrameLabels()
    number = 0

    def reset(self, **_: Any) -> Any:
        return None, {}

    def _running(self) -> Any:
        return SimpleNamespace(obj=None)

    def step(self, action: np.ndarray) -> Any:
        self.number += 1
        self.labels = KeyFrameLabels(0, self.number != 3, 0.0, 0, 0.2)
        return None, 0.0, False, self.number == self.max_key_frames, {}


def test_what_has_failed_counts_until_something_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_choices, "choice", lambda env, action, closed, ranges: PULL)
    monkeypatch.setattr(check_choices, "joint_ranges", lambda obj: {})
    tally, actor = Tally(), Stubborn()
    play(Locked(), actor, 0, {"locked": True}, samples=2, tally=tally)  # type: ignore[arg-type]
    rows = {row["failed"]: row for row in tally.to_json()["after"]}
    assert rows[0]["draws"] == {"door +": 4}  # before the first try, and after the one that gave
    assert rows[1]["repeat_of_tries"] == 1.0
    assert rows[1]["draws"] == {"door +": 8}
    assert tally.to_json()["episodes"] == {"locked True": [1, 0]}


def test_a_motion_is_named_by_what_it_would_try(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def found(frame: Any, parts: Any, ranges: Any, joints: Any) -> Any:
        seen.append(frame)
        return SimpleNamespace(joint="knob", sent=-0.4)

    monkeypatch.setattr(check_choices, "find_try", found)
    env = SimpleNamespace(feedback=None, annotations={}, part_positions=dict)
    action = np.array([0.4, 0.1, 0.3, 1, 0, 0, 0, 1, 0, 0.2], np.float32)
    assert check_choices.choice(env, action, True, {}) == RIGHT
    np.testing.assert_allclose(seen[0].goal[:3, 3], action[:3], atol=1e-6)
    np.testing.assert_allclose(seen[0].goal[:3, :3], np.eye(3), atol=1e-6)
    assert seen[0].gripper == pytest.approx(0.2)
