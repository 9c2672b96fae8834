"""What lies between a failed try and its repetition, on key frames written by hand, without a simulator."""

from __future__ import annotations

import numpy as np
import pytest
from show_repeats import AFTER_A_SEARCH, ANOTHER, AT_ONCE, SMALL, Step, kind

from lerobot_adamanip.contract.keyframes import KeyFrameLabels
from lerobot_adamanip.contract.rotations import rotation_about, transform

HERE = np.eye(4)
NO_TRY = KeyFrameLabels()
PULL = KeyFrameLabels(tried=0, failed=True, direction=1)


def step(x: float = 0.0, opening: float = 0.0, labels: KeyFrameLabels = NO_TRY, turn: float = 0.0) -> Step:
    pose = transform((x, 0.0, 0.0), rotation_about((0, 0, 1), turn))
    return Step(HERE, pose, opening, pose, labels)


FAILED = Step(HERE, transform((0.05, 0.0, 0.0)), 0.0, HERE, PULL)


@pytest.mark.parametrize(
    ("between", "again", "result"),
    [
        ([], step(0.05, labels=PULL), AT_ONCE),
        ([], step(0.005, labels=PULL), SMALL),
        ([], step(0.005, labels=PULL, turn=0.2), AT_ONCE),
        ([step(opening=1.0), step(0.2)], step(0.05, labels=PULL), AFTER_A_SEARCH),
        ([step(0.2)], step(0.05, labels=PULL), AT_ONCE),  # the hand has held the part
        ([step(0.02, opening=1.0)], step(0.05, labels=PULL), AT_ONCE),  # it has closed anew
        ([], step(0.05, labels=KeyFrameLabels(tried=0, direction=-1)), ANOTHER),
        ([], step(0.05, labels=KeyFrameLabels(tried=1, direction=1)), ANOTHER),
    ],
)
def test_a_next_try_is_of_one_kind(between: list[Step], again: Step, result: str) -> None:
    assert kind(FAILED, between, again) == result
