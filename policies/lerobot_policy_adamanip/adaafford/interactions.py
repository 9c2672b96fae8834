"""Interactions: motions in contact with a part and their results, in a dataset and in an episode at run time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.affordance.demonstrations import ContactTracker, Demonstrations
from lerobot_policy_adamanip.affordance.plans import holds_something

Array = NDArray[np.float32]


@dataclass(frozen=True)
class InteractionLabels:
    """Interactions of a dataset; for each row, the earlier ones and those with a known result.

    Attributes:
        before: (M, 10) float32 tool pose, with the measured gripper.
        command: (M, 10) float32 pose sent.
        after: (M, 10) float32 pose reached, with the measured gripper.
        opening: (M,) float32 gripper opening during the approach, 1 to grasp, 0 to push.
        moved: (M,) float32, 1 if the interaction brought the object nearer to open, else 0.
        tried: (M,) bool, whether the interaction tried to move a joint; the actor learns only these.
        history: (I, H) int64 interactions before the row with this `index`, oldest first, padded with -1.
        candidates: (I, K) int64 interactions with a known result at that row, padded with -1.
    """

    before: Array
    command: Array
    after: Array
    opening: Array
    moved: Array
    tried: NDArray[np.bool_]
    history: NDArray[np.int64]
    candidates: NDArray[np.int64]


def label_interactions(demonstrations: Demonstrations, history: int, candidates: int) -> InteractionLabels:
    """Finds interactions, and assigns to each row the interactions that it can learn from.

    An interaction is a key frame in contact (`ContactTracker`). An expert's try that did not fail brought the object
    nearer to open, because it never turns back; what else was sent is history only. The result holds at all rows of its
    stretch, in which nothing moved. The way back of each motion is added as one without success, although not tried.

    A row keeps the latest ``history`` interactions before it, and up to ``candidates`` with a known result. Raises
    `ConfigurationError` if no try failed, or none moved anything.
    """
    recorded: list[_Interaction] = []
    past, known = (np.full((len(demonstrations), count), -1, dtype=np.int64) for count in (history, candidates))
    for rows in demonstrations.episodes():
        first, stretch = len(recorded), demonstrations.stretches(rows)
        recorded += _interactions(demonstrations, rows, stretch)
        numbered = list(enumerate(recorded[first:], first))
        for row in range(rows.stop - rows.start - int(demonstrations.final[rows.stop - 1])):
            earlier = [number for number, each in numbered if each.row is not None and each.row < row][-history:]
            fitting = [number for number, each in numbered if each.stretch == stretch[row]][:candidates]
            place = rows.start + row
            past[place, : len(earlier)], known[place, : len(fitting)] = earlier, fitting
    moved, tried = (np.array([getattr(each, name) for each in recorded], bool) for name in ("moved", "tried"))
    if not (tried & ~moved).any() or not (tried & moved).any():
        raise ConfigurationError(
            "These demonstrations do not show failed and successful tries.",
            got=f"{int(tried.sum())} tries, {int((tried & ~moved).sum())} of them failed",
            allowed="demonstrations with failed and with successful tries",
            hint="adamanip collect DIR --category safe --expert adaptive",
        )
    before, command, after = (np.stack([each.poses[place] for each in recorded]) for place in range(3))
    opening = np.array([each.opening for each in recorded], np.float32)
    return InteractionLabels(before, command, after, opening, moved.astype(np.float32), tried, past, known)


@dataclass(frozen=True)
class _Interaction:
    """Poses before, sent and after; the row in its episode, None for a way back; the stretch of a known result."""

    poses: tuple[Array, Array, Array]
    opening: float
    moved: bool
    tried: bool
    row: int | None
    stretch: int | None


def _interactions(demonstrations: Demonstrations, rows: slice, stretch: NDArray[np.int64]) -> Iterator[_Interaction]:
    """Yields an episode's interactions."""
    for contact in demonstrations.contacts(rows):
        opening = float(contact.grasp[GRIPPER_DIM])
        for row in range(contact.first, min(contact.end, rows.stop - 1)):
            start, reached = demonstrations.poses[row], demonstrations.poses[row + 1]
            tried = bool(demonstrations.meant[row] and demonstrations.tried[row] >= 0)
            failed = bool(demonstrations.failed[row])
            place, poses = row - rows.start, (start, demonstrations.commands[row], reached)
            known = int(stretch[place]) if tried else None
            yield _Interaction(poses, opening, tried and not failed, tried, place, known)
            if tried and not failed:
                closed = np.append(start[:GRIPPER_DIM], np.float32(0.0))
                yield _Interaction((reached, closed, closed), opening, False, False, None, int(stretch[place]) + 1)


class InteractionMemory:
    """Interactions of one episode at run time; the latest ``length`` are kept."""

    def __init__(self, length: int) -> None:
        self.interactions: deque[tuple[Tensor, Tensor, Tensor]] = deque(maxlen=length)
        self.made = 0
        self.sent: tuple[Tensor, Tensor] | None = None
        """Pose before the latest command, and the command (10,) each, until its result is observed."""
        self._tracker = ContactTracker()

    @property
    def opening(self) -> float | None:
        """Gripper opening during the approach to the part in contact; None without contact."""
        return self._tracker.opening

    def observe(self, pose: Tensor) -> None:
        """Stores the latest command and its result, the present pose (10,). Ignores commands without contact."""
        if self.sent is None:
            return
        before, command = self.sent
        if self._tracker.sent(*(each.cpu().numpy().astype(np.float32) for each in self.sent)):
            self.interactions.append((before, command, pose))
            self.made += 1
        self.sent = None

    def holds(self, pose: Tensor) -> bool:
        """Returns whether a hand at ``pose`` (10,) is still in contact: pushing, or with a part between its fingers."""
        return self.opening == 0.0 or (self.opening is not None and holds_something(pose))
