"""Dataset columns that labels are computed from, and the contacts of episodes.

A training batch lacks ``complementary_info.*`` and ``next.success``, which hold a row's try and its result. Labels are
computed from the files when a policy is created, and looked up by ``index``. They do not exist at run time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import CLOSED_HAND, EMPTY_HAND, OPEN_HAND
from lerobot_policy_adamanip.common.inputs import EPISODE, INDEX, are_same_actions, is_trained, read_columns

MIN_CLEARANCE_M = 0.05
"""A hand at least this far from a grasp does not hide the part."""
MAX_GRASP_TRAVEL_M = 0.03
"""A hand that moves at most this far while it closes grasps; a hand that moves farther pushes."""


@dataclass(frozen=True)
class Demonstrations:
    """Columns of a dataset, one entry per row.

    Attributes:
        index, episode, task: (T,) int64, LeRobot's ``index``, ``episode_index`` and ``task_index``.
        poses: (T, 10) float32 tool pose and gripper before the row's command.
        commands: (T, 10) float32 executed pose.
        meant: (T,) bool, whether the command is the expert's own: not a mistake, and not a policy's.
        tried: (T,) int64 joint that the command tried to move, -1 for none.
        failed: (T,) bool, whether that joint did not follow.
        success: (T,) bool, whether the task is done after the command.
        final: (T,) bool, whether the row is an episode's final observation, whose command was not sent.
        trained: (T,) bool, whether the row's episode is trained on; the others are held out.
        joints: (T, 4) float32 positions of the object's joints before the command [rad or m].
    """

    index: NDArray[np.int64]
    episode: NDArray[np.int64]
    task: NDArray[np.int64]
    poses: NDArray[np.float32]
    commands: NDArray[np.float32]
    meant: NDArray[np.bool_]
    tried: NDArray[np.int64]
    failed: NDArray[np.bool_]
    success: NDArray[np.bool_]
    final: NDArray[np.bool_]
    trained: NDArray[np.bool_]
    joints: NDArray[np.float32]

    def __len__(self) -> int:
        """Returns the number of rows."""
        return len(self.index)

    def episodes(self) -> Iterator[slice]:
        """Yields the rows of each episode."""
        starts = np.flatnonzero(np.diff(self.episode, prepend=-1))
        for start, end in zip(starts, [*starts[1:], len(self)], strict=True):
            yield slice(int(start), int(end))

    def trained_episodes(self) -> Iterator[slice]:
        """Yields the rows of each episode that is trained on."""
        return (rows for rows in self.episodes() if self.trained[rows.start])

    def open_and_away(self, rows: NDArray[np.int64], place: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Returns whether at rows (R,) the hand is open and `MIN_CLEARANCE_M` away from a place (3,) [m]."""
        poses = self.poses[rows]
        away: NDArray[np.bool_] = np.linalg.norm(poses[:, :3] - place, axis=1) > MIN_CLEARANCE_M
        return away & (poses[:, schema.GRIPPER_DIM] > OPEN_HAND)

    def stretches(self, rows: slice) -> NDArray[np.int64]:
        """Returns, for each row (T,) of an episode, the number of earlier tries that moved a joint.

        Rows with the same number are a stretch in which nothing moved: a try has the same result at all of them. A row
        whose try moves something is the last of its stretch.
        """
        moved = (self.tried[rows] >= 0) & ~self.failed[rows]
        before: NDArray[np.int64] = np.cumsum(moved) - moved
        return before

    def contacts(self, rows: slice) -> list[Contact]:
        """Returns the contacts of an episode by its rows, see `find_contacts`, without hands that closed on nothing."""
        sent = slice(rows.start, rows.stop - int(self.final[rows.stop - 1]))
        contacts = find_contacts(self.poses[sent], self.commands[sent], first_row=rows.start)
        held = np.append(self.poses[: rows.stop, schema.GRIPPER_DIM] >= EMPTY_HAND, True)
        return [each for each in contacts if held[each.first] or not each.grasps]


def read_demonstrations(dataset_meta: Any) -> Demonstrations:
    """Returns a dataset's columns; raises `ConfigurationError` as `read_columns` does."""
    numbers = (INDEX, EPISODE, "task_index", schema.TRIED, schema.FAILED, schema.SUCCESS, schema.DONE)
    read = read_columns(dataset_meta, (*numbers, schema.STATE, schema.ACTION, schema.EXECUTED, schema.JOINTS))
    index, episode, task, tried, failed, success, done = (read[key].reshape(-1) for key in numbers)
    last = np.append(np.diff(episode) != 0, True)
    return Demonstrations(
        index.astype(np.int64),
        episode.astype(np.int64),
        task.astype(np.int64),
        read[schema.STATE][:, : schema.ACTION_DIM],
        read[schema.EXECUTED],
        are_same_actions(read[schema.ACTION], read[schema.EXECUTED]),
        tried.astype(np.int64),
        failed.astype(np.bool_),
        success.astype(np.bool_),
        done.astype(np.bool_) & last,
        is_trained(dataset_meta, episode),
        read[schema.JOINTS][:, -schema.MAX_OBJECT_JOINTS :],
    )


@dataclass(frozen=True)
class Contact:
    """Rows of an episode in which the hand is closed at a part.

    Attributes:
        start: row in which the fingers close.
        grasp: (10,) float32 pose of contact; gripper: opening of the approach, 1 for a grasp, 0 for a push.
        first: row of the first motion in contact.
        end: row after the last one.
    """

    start: int
    grasp: NDArray[np.float32]
    first: int
    end: int

    @property
    def grasps(self) -> bool:
        """Whether the hand closed in place; else it pushes."""
        return bool(self.grasp[schema.GRIPPER_DIM] > 0)


class ContactTracker:
    """Tracks from key frame to key frame whether a hand is in contact with a part.

    A hand that closes in place grasps; motions follow. A hand that closes while it moves will push: the next command
    takes it to the part, then motions follow. A hand closed from the start has no contact until it has opened.

    Attributes:
        opening: gripper opening during the approach, 1 to grasp, 0 to push; None without contact.
    """

    def __init__(self) -> None:
        self.opening: float | None = None
        self._pushes, self._was_closed = False, False

    def sent(self, pose: NDArray[np.float32], command: NDArray[np.float32]) -> bool:
        """Processes a command (10,) sent at ``pose`` (10,); returns whether it was a motion in contact."""
        in_contact = self.opening is not None
        if command[schema.GRIPPER_DIM] >= CLOSED_HAND:
            self.opening, self._pushes, self._was_closed = None, False, False
            return False
        if self._pushes:
            self.opening, self._pushes = 0.0, False
        elif not self._was_closed and pose[schema.GRIPPER_DIM] > OPEN_HAND:
            in_place = float(np.linalg.norm(command[:3] - pose[:3])) < MAX_GRASP_TRAVEL_M
            self.opening, self._pushes = (1.0, False) if in_place else (None, True)
        self._was_closed = True
        return in_contact


def find_contacts(poses: NDArray[np.float32], commands: NDArray[np.float32], first_row: int = 0) -> list[Contact]:
    """Returns the contacts of an episode, as `ContactTracker` finds them, from poses (T, 10) and commands (T, 10)."""
    tracker, contacts, met = ContactTracker(), list[Contact](), -1

    def add(opening: float, end: int) -> None:
        grasp = np.append(commands[met][: schema.GRIPPER_DIM], np.float32(opening))
        start = met if opening else met - 1
        contacts.append(Contact(start + first_row, grasp, met + 1 + first_row, end + first_row))

    for row, (pose, command) in enumerate(zip(poses, commands, strict=True)):
        before = tracker.opening
        tracker.sent(pose, command)
        if before is None and tracker.opening is not None:
            met = row
        if tracker.opening is None and before is not None:
            add(before, row)
    if tracker.opening is not None:
        add(tracker.opening, len(commands))
    return contacts
