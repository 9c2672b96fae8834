"""Columns read from files, and the contacts of an episode."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.affordance.demonstrations import (
    ContactTracker,
    find_contacts,
    read_demonstrations,
)
from lerobot_policy_adamanip.common.inputs import read_columns


def episode(*key_frames: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Poses and commands of an arm that gets wherever it is sent: of each key frame its x [m] and its gripper."""
    commands = np.zeros((len(key_frames), schema.ACTION_DIM), np.float32)
    commands[:, 0], commands[:, schema.GRIPPER_DIM] = zip(*key_frames, strict=True)
    poses = np.concatenate([np.eye(1, schema.ACTION_DIM, schema.GRIPPER_DIM, dtype=np.float32), commands[:-1]])
    return poses, commands


CONTACTS: dict[str, tuple[list[tuple[float, int]], list[tuple[int, int, int, float, int]]]] = {
    "a hand that closes in place grasps": (
        [(0.4, 1), (0.5, 1), (0.5, 0), (0.6, 0), (0.7, 0), (0.7, 1), (0.3, 1)], [(2, 3, 5, 0.5, 1)],
    ),
    "one that closes on its way pushes": ([(0.4, 0), (0.5, 0), (0.53, 0), (0.4, 0), (0.2, 1)], [(0, 2, 4, 0.5, 0)]),
    "and if it goes no farther, nothing": ([(0.5, 0), (0.5, 1)], []),
    "each closing, also the last, which nothing opens": (
        [(0.5, 1), (0.5, 0), (0.6, 0), (0.6, 1), (0.5, 1), (0.5, 0), (0.55, 0)], [(1, 2, 3, 0.5, 1), (5, 6, 7, 0.5, 1)],
    ),
    "both": (
        [(0.4, 0), (0.5, 0), (0.53, 0), (0.2, 1), (0.2, 0), (0.3, 0), (0.3, 1), (0.3, 0)],
        [(0, 2, 3, 0.5, 0), (4, 5, 6, 0.2, 1), (7, 8, 8, 0.3, 1)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CONTACTS)
def test_contacts_are_found_and_their_motions_are_those_that_the_tracker_tells(case: str) -> None:
    key_frames, wanted = CONTACTS[case]
    poses, commands = episode(*key_frames)
    found = find_contacts(poses, commands)
    told = [(each.start, each.first, each.end, each.grasp[0], each.grasp[schema.GRIPPER_DIM]) for each in found]
    assert told == [pytest.approx(each) for each in wanted]
    tracker = ContactTracker()
    moves = [tracker.sent(pose, command) for pose, command in zip(poses, commands, strict=True)]
    assert np.flatnonzero(moves).tolist() == [row for each in found for row in range(each.first, each.end)]


def test_a_hand_that_was_closed_before_the_episode_began_shows_no_contact() -> None:
    poses, commands = episode((0.5, 0), (0.6, 0), (0.6, 1))
    poses[0, schema.GRIPPER_DIM] = 0.2
    assert find_contacts(poses, commands) == []


def test_a_stretch_ends_with_what_moves_something(adaptive_toy_root: Path) -> None:
    demonstrations = read_demonstrations(SimpleNamespace(root=adaptive_toy_root))
    assert demonstrations.failed.any()
    for rows in demonstrations.episodes():
        stretch = demonstrations.stretches(rows)
        joints = demonstrations.joints[rows]
        assert stretch[0] == 0
        for number in range(stretch[-1] + 1):
            stands = joints[stretch == number]
            np.testing.assert_allclose(stands, np.broadcast_to(stands[0], stands.shape), atol=1e-5)
        moved = (demonstrations.tried[rows] >= 0) & ~demonstrations.failed[rows]
        assert stretch[-1] == moved[:-1].sum()


def test_a_final_observation_is_not_a_motion(adaptive_toy_root: Path) -> None:
    demonstrations = read_demonstrations(SimpleNamespace(root=adaptive_toy_root))
    spans = list(demonstrations.episodes())
    assert sum(rows.stop - rows.start for rows in spans) == len(demonstrations)
    assert int(demonstrations.final.sum()) == len(spans) == 6
    for rows in spans:
        assert demonstrations.final[rows.stop - 1]
        contacts = demonstrations.contacts(rows)
        assert contacts
        assert max(contact.end for contact in contacts) <= rows.stop - 1
        for contact in contacts:
            np.testing.assert_array_equal(contact.grasp[:9], demonstrations.commands[contact.first - 1, :9])


def test_files_that_are_not_there_are_one_clear_error(toy_root: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="downloaded"):
        read_demonstrations(SimpleNamespace(root=tmp_path))
    with pytest.raises(ConfigurationError, match=r"no complementary_info\.unheard_of"):
        read_columns(SimpleNamespace(root=toy_root), ("complementary_info.unheard_of", schema.STATE))


def test_a_hand_that_closed_on_nothing_has_no_contact(adaptive_toy_root: Path) -> None:
    demonstrations = read_demonstrations(SimpleNamespace(root=adaptive_toy_root))
    rows = next(demonstrations.episodes())
    contacts = demonstrations.contacts(rows)
    empty = demonstrations.poses.copy()
    empty[contacts[0].first, schema.GRIPPER_DIM] = 0.0
    assert replace(demonstrations, poses=empty).contacts(rows) == contacts[1:]
