"""Interactions: what was done in contact with a part, and what came of it; and which of them a row can learn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.demonstrations import Demonstrations

Array = NDArray[np.float32]


@dataclass(frozen=True)
class InteractionLabels:
    """Interactions of a dataset, and for each row those before it and those whose outcome at this row is known.

    Attributes:
        before: (M, 10) float32 tool pose; for a real interaction with the gripper that was felt.
        command: (M, 10) float32 pose that was sent.
        after: (M, 10) float32 pose that was reached, and the gripper felt.
        opening: (M,) float32 opening with which the part had been approached, 1 to grasp, 0 to push.
        moved: (M,) float32, 1 if it brought the object nearer to open, 0 if not.
        tried: (M,) bool: an interaction that was meant to move a joint, of which an actor can learn what to try.
        history: (I, H) int64 interactions before the row with this `index`, oldest first, then -1.
        candidates: (I, K) int64 interactions whose outcome at that row is known, then -1.
    """

    before: Array
    command: Array
    after: Array
    opening: Array
    moved: Array
    tried: NDArray[np.bool_]
    history: NDArray[np.int64]
    candidates: NDArray[np.int64]


@dataclass
class _Recorded:
    """Interactions as they are found, one entry each."""

    before: list[Array]
    command: list[Array]
    after: list[Array]
    opening: list[float]
    moved: list[float]
    tried: list[bool]

    def add(self, before: Array, command: Array, after: Array, opening: float, *, moved: bool, tried: bool) -> int:
        """Returns its number."""
        self.before.append(before)
        self.command.append(command)
        self.after.append(after)
        self.opening.append(opening)
        self.moved.append(float(moved))
        self.tried.append(tried)
        return len(self.moved) - 1

    def labels(self, history: NDArray[np.int64], candidates: NDArray[np.int64]) -> InteractionLabels:
        """Returns them with what each row can learn from; raises `ConfigurationError` as `label_interactions` does."""
        tried, moved = np.array(self.tried, np.bool_), np.array(self.moved, np.float32)
        if not (tried & (moved == 0)).any() or not (tried & (moved == 1)).any():
            raise ConfigurationError(
                "There is nothing to adapt to in these demonstrations.",
                got=f"{int(tried.sum())} tries, of which {int((moved[tried] == 0).sum())} failed",
                allowed="demonstrations in which some tries fail, and some do not",
                hint="adamanip collect --expert adaptive",
            )
        return InteractionLabels(
            before=np.stack(self.before),
            command=np.stack(self.command),
            after=np.stack(self.after),
            opening=np.array(self.opening, np.float32),
            moved=moved,
            tried=tried,
            history=history,
            candidates=candidates,
        )


def label_interactions(demonstrations: Demonstrations, history: int, candidates: int) -> InteractionLabels:
    """Finds interactions, and what each row can learn from them.

    An interaction is a key frame in contact (`ContactTracker`), and brought the object nearer to open if it was a try
    that did not fail: an expert never turns back. What it came to, it would have come to at every row of its stretch,
    in which nothing moved. Once something has moved, the way back brings the object no nearer: that is an interaction
    too, though nobody made it.

    Args:
        demonstrations: of an expert that tries, and fails.
        history: interactions before a row at most, H: the latest.
        candidates: interactions at most whose outcome at a row is known, K.

    Raises:
        ConfigurationError: no try failed, or none moved anything.
    """
    recorded = _Recorded([], [], [], [], [], [])
    size = 1 + int(demonstrations.index.max())
    past, known = (np.full((size, count), -1, dtype=np.int64) for count in (history, candidates))
    for rows in demonstrations.episodes():
        made, at = _episode(demonstrations, rows, recorded)
        stretch = demonstrations.stretches(rows)
        for row in range(rows.stop - rows.start - int(demonstrations.final[rows.stop - 1])):
            index = demonstrations.index[rows.start + row]
            _fill(past[index], [number for number, when in made if when < row][-history:])
            _fill(known[index], [number for number, when in at if when == stretch[row]][:candidates])
    return recorded.labels(past, known)


def _episode(
    demonstrations: Demonstrations, rows: slice, recorded: _Recorded
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Records an episode's interactions.

    Returns:
        made: number and row (from 0) of each real interaction; known: number and stretch of those whose outcome is
        known there.
    """
    made: list[tuple[int, int]] = []
    known: list[tuple[int, int]] = []
    stretch = demonstrations.stretches(rows)
    for contact in demonstrations.contacts(rows):
        opening = float(contact.grasp[GRIPPER_DIM])
        for row in range(contact.first, min(contact.end, rows.stop - 1)):
            start, reached = demonstrations.poses[row], demonstrations.poses[row + 1]
            tried, failed = demonstrations.tried[row] >= 0, bool(demonstrations.failed[row])
            number = recorded.add(
                start, demonstrations.commands[row], reached, opening, moved=tried and not failed, tried=bool(tried)
            )
            made.append((number, row - rows.start))
            if not tried:
                continue
            known.append((number, int(stretch[row - rows.start])))
            if not failed:
                closed = np.append(start[:GRIPPER_DIM], np.float32(0.0))
                back = recorded.add(reached, closed, closed, opening, moved=False, tried=False)
                known.append((back, int(stretch[row - rows.start]) + 1))
    return made, known


def _fill(row: NDArray[np.int64], numbers: list[int]) -> None:
    row[: len(numbers)] = numbers
