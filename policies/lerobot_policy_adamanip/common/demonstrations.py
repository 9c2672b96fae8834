"""A dataset's narrow columns, read once when a policy is made: what labels are taken from, besides the clouds.

LeRobot hands a policy's `forward` only observations, actions and a row's `index`; what a row tried and what came of it
(``complementary_info.*``, ``next.*``) does not pass. Labels are therefore made from the files beforehand and looked up
by `index`. They teach; a policy at run time has none of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import OPEN_HAND
from lerobot_adamanip.contract.schema import (
    ACTION,
    ACTION_DIM,
    DONE,
    EXECUTED,
    FAILED,
    GRIPPER_DIM,
    JOINTS,
    MAX_OBJECT_JOINTS,
    STATE,
    SUCCESS,
    TRIED,
)
from lerobot_adamanip.episode.contact_labels import CLOSED
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.recorded_rows import EPISODE, INDEX, RecordedRows

IS_LABEL = "is_label"
"""Column of `read_recorded_rows`: false at the `unfinished_ends`."""
AWAY = 0.05
"""A hand at least this far from a grasp does not hide the part [m]."""
IN_PLACE = 0.03
"""A hand that closes within this distance of where it is grasps; one that closes on its way goes to push [m]."""


def has_files(dataset_meta: Any) -> bool:
    """Returns whether a dataset's rows are beside its metadata: not before they have been downloaded, or streamed."""
    return (Path(dataset_meta.root) / "data").is_dir()


def read_columns(dataset_meta: Any, keys: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Returns numeric columns of a dataset, rows in order of their `index`: key -> (rows, ...), floats as float32.

    Raises:
        ConfigurationError: the files are not there, or lack a column.
    """
    import pyarrow.dataset as files

    folder = Path(dataset_meta.root) / "data"
    if not has_files(dataset_meta):
        raise ConfigurationError(
            "The demonstrations' columns cannot be read.",
            got=f"no folder {folder.name} beside the metadata",
            allowed="a dataset whose files have been downloaded",
            hint="--dataset.streaming=false; in Python, LeRobotDataset(repo_id) before the policy is made",
        )
    source, keys = files.dataset(folder, format="parquet"), list(keys)
    missing = [key for key in keys if key not in source.schema.names]
    if missing:
        raise ConfigurationError(
            "The demonstrations lack columns that labels are made from.",
            got=f"no {', '.join(missing)}",
            allowed="the columns of this project's contract, see docs/dataset_columns.md",
            hint="adamanip collect",
        )
    table = source.to_table(columns=sorted({*keys, "index"})).sort_by("index")
    columns = {key: _array(table, key) for key in keys}
    return {key: found.astype(np.float32) if found.dtype.kind == "f" else found for key, found in columns.items()}


def _array(table: Any, key: str) -> NDArray[Any]:
    values = numeric_array(table[key])
    return np.stack(table[key].to_numpy()) if values is None else values


def read_recorded_rows(dataset_meta: Any) -> RecordedRows:
    """Returns what `dp3_adaptive` looks up: states, labels, executed actions, and whether a row's action is a label.

    Raises:
        ConfigurationError: as `read_columns` does.
    """
    executed = EXECUTED if EXECUTED in dataset_meta.features else ACTION
    columns = read_columns(dataset_meta, dict.fromkeys((INDEX, EPISODE, STATE, ACTION, executed)))
    is_label = ~np.isin(columns[INDEX].reshape(-1), unfinished_ends(dataset_meta))
    return RecordedRows({**columns, EXECUTED: columns[executed], IS_LABEL: is_label})


def unfinished_ends(dataset_meta: Any) -> NDArray[np.int64]:
    """Returns the `index` of each last row whose episode did not succeed; none where the dataset does not tell.

    An episode's last row is its final observation, with a command to stay that was not sent. Where the object is open,
    to stay is right. Where a correction has run out of key frames, it would teach to stay where the policy is stuck.
    """
    keys = ("index", DONE, SUCCESS)
    if not set(keys) <= set(dataset_meta.features) or not has_files(dataset_meta):
        return np.empty(0, np.int64)
    index, done, success = (column.reshape(-1) for column in read_columns(dataset_meta, keys).values())
    ends: NDArray[np.int64] = index[done.astype(np.bool_) & ~success.astype(np.bool_)].astype(np.int64)
    return ends


@dataclass(frozen=True)
class Demonstrations:
    """Columns of a dataset, one entry a row.

    Attributes:
        index: (T,) int64, of the row in the dataset: what a batch calls ``index``.
        episode: (T,) int64.
        task: (T,) int64: what is to be done, see LeRobot's ``task_index``.
        poses: (T, 10) float32 tool pose and gripper before the row's command, of the contract.
        commands: (T, 10) float32 pose that was sent.
        tried: (T,) int64 joint that the command tried to move, -1 for none.
        failed: (T,) bool, whether it did not follow.
        success: (T,) bool, whether the task is done after the command.
        final: (T,) bool: the row is an episode's last observation, whose command was not sent.
        joints: (T, 4) float32 positions of the object's joints before the command [rad or m].
    """

    index: NDArray[np.int64]
    episode: NDArray[np.int64]
    task: NDArray[np.int64]
    poses: NDArray[np.float32]
    commands: NDArray[np.float32]
    tried: NDArray[np.int64]
    failed: NDArray[np.bool_]
    success: NDArray[np.bool_]
    final: NDArray[np.bool_]
    joints: NDArray[np.float32]

    def __len__(self) -> int:
        """Rows."""
        return len(self.index)

    def episodes(self) -> Iterator[slice]:
        """Rows of each episode in turn."""
        starts = np.flatnonzero(np.diff(self.episode, prepend=-1))
        for start, end in zip(starts, [*starts[1:], len(self)], strict=True):
            yield slice(int(start), int(end))

    def open_and_away(self, rows: NDArray[np.int64], place: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Returns at which of some rows (R,) the hand holds nothing, and is `AWAY` from a place (3,) [m]."""
        poses = self.poses[rows]
        away: NDArray[np.bool_] = np.linalg.norm(poses[:, :3] - place, axis=1) > AWAY
        return away & (poses[:, GRIPPER_DIM] > OPEN_HAND)

    def stretches(self, rows: slice) -> NDArray[np.int64]:
        """Returns how many tries of an episode had moved a joint before each of its rows (T,).

        Rows of one number belong to one stretch: everything stands as it did, so what a try came to at one of them it
        would have come to at the others. A row whose try moves something is the last of its stretch.
        """
        moved = (self.tried[rows] >= 0) & ~self.failed[rows]
        before: NDArray[np.int64] = np.cumsum(moved) - moved
        return before

    def contacts(self, rows: slice) -> list[Contact]:
        """Returns the contacts of the episode whose rows these are; see `find_contacts`."""
        sent = slice(rows.start, rows.stop - int(self.final[rows.stop - 1]))
        found = find_contacts(self.poses[sent], self.commands[sent])
        return [contact.shifted(rows.start) for contact in found]


def read_demonstrations(dataset_meta: Any) -> Demonstrations:
    """Returns what labels are made from; raises `ConfigurationError` as `read_columns` does."""
    numbers = ("index", "episode_index", "task_index", TRIED, FAILED, SUCCESS, DONE)
    read = read_columns(dataset_meta, (*numbers, STATE, EXECUTED, JOINTS))
    index, episode, task, tried, failed, success, done = (read[key].reshape(-1) for key in numbers)
    last = np.append(np.diff(episode) != 0, True)
    return Demonstrations(
        index.astype(np.int64),
        episode.astype(np.int64),
        task.astype(np.int64),
        read[STATE][:, :ACTION_DIM],
        read[EXECUTED],
        tried.astype(np.int64),
        failed.astype(np.bool_),
        success.astype(np.bool_),
        done.astype(np.bool_) & last,
        read[JOINTS][:, -MAX_OBJECT_JOINTS:],
    )


@dataclass(frozen=True)
class Contact:
    """A stretch of an episode in which the hand is closed, and how it came to be at a part.

    Attributes:
        start: row in which the fingers close.
        grasp: (10,) float32 pose at which the part is met; its gripper is the opening that it is approached with, 1 to
            grasp, 0 to push.
        first: row of the first motion in contact.
        end: row behind the last one.
    """

    start: int
    grasp: NDArray[np.float32]
    first: int
    end: int

    def shifted(self, rows: int) -> Contact:
        """Returns the contact with its rows counted from elsewhere."""
        return Contact(self.start + rows, self.grasp, self.first + rows, self.end + rows)


class ContactTracker:
    """Follows a hand from one key frame to the next: is it in contact with a part, and how did it get there?

    A hand that closes where it is grasps: the motions follow. One that closes on its way is going to push: the next
    command leads it to the part, the motions follow then. How a hand that is closed from the start on came to its part
    is not known; it is not in contact before it has opened.

    Attributes:
        opening: of the fingers when the part was met, 1 to grasp, 0 to push; None where the hand is not in contact.
    """

    def __init__(self) -> None:
        self.opening: float | None = None
        self._pushes, self._was_closed = False, False

    def sent(self, pose: NDArray[np.float32], command: NDArray[np.float32]) -> bool:
        """Follows one key frame; returns whether it was a motion in contact.

        Args:
            pose: (10,) tool pose and gripper before it.
            command: (10,) pose that was sent.
        """
        in_contact = self.opening is not None
        if command[GRIPPER_DIM] >= CLOSED:
            self.opening, self._pushes, self._was_closed = None, False, False
            return False
        if self._pushes:
            self.opening, self._pushes = 0.0, False
        elif not self._was_closed and pose[GRIPPER_DIM] > OPEN_HAND:
            in_place = float(np.linalg.norm(command[:3] - pose[:3])) < IN_PLACE
            self.opening, self._pushes = (1.0, False) if in_place else (None, True)
        self._was_closed = True
        return in_contact


def find_contacts(poses: NDArray[np.float32], commands: NDArray[np.float32]) -> list[Contact]:
    """Returns the contacts of an episode in order, as a `ContactTracker` finds them.

    Args:
        poses: (T, 10) tool pose and gripper before each command.
        commands: (T, 10) poses that were sent.
    """
    tracker, found, met = ContactTracker(), list[Contact](), -1
    for row, (pose, command) in enumerate(zip(poses, commands, strict=True)):
        before = tracker.opening
        tracker.sent(pose, command)
        if before is None and tracker.opening is not None:
            met = row
        if tracker.opening is None and before is not None:
            found.append(_contact(commands[met], met, before, row))
    if tracker.opening is not None:
        found.append(_contact(commands[met], met, tracker.opening, len(commands)))
    return found


def _contact(command: NDArray[np.float32], met: int, opening: float, end: int) -> Contact:
    grasp = np.append(command[:GRIPPER_DIM], np.float32(opening))
    return Contact(met if opening else met - 1, grasp, met + 1, end)
