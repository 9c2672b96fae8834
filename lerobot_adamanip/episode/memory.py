"""Memory of an episode's felt tries for any policy, computed from a stream of states and actions.

Simulator, collections, recordings and robot use this class on the same float32 numbers, so they give equal memories.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.contract.control import DENSE, EE_DELTA, FINGER_TRAVEL, FULL, KEYFRAME, STATES
from lerobot_adamanip.contract.dense_codec import pose_of_delta
from lerobot_adamanip.contract.memory import (
    MAX_MOTION,
    MAX_TIMES,
    MOTION_UNITS,
    NO_MEMORY,
    NUM_TRIES,
    SO_FAR,
    TEXT,
    TRY_NAMES,
    instruction_of,
)
from lerobot_adamanip.contract.rotations import matrix_from_rotation_vector, pose_from_vector, pose_vector, transform
from lerobot_adamanip.contract.schema import ACTION_DIM, EXECUTED, STATE
from lerobot_adamanip.episode.felt_tries import MIN_TURN_RAD, FeltEvent, FeltTries, HandPose

TIMES = {1: "", 2: " twice"}
"""Number of equal tries -> its word."""


class Memory:
    """Memory of one episode at a time.

    Args:
        control: see `contract.control.CONTROLS`.
        action: kind of dense action, see `ACTION_NAMES`; key frames have poses.
        fps: steps per second of dense control.
    """

    def __init__(self, *, control: str = KEYFRAME, action: str = EE_DELTA, fps: int | None = None) -> None:
        self._is_delta = control == DENSE and action == EE_DELTA
        self._fps = fps if control == DENSE else None
        self.reset()

    @classmethod
    def of(cls, options: Any) -> Memory | None:
        """Returns the memory of an environment with these `EnvironmentOptions`; None if it has none."""
        if options.memory == NO_MEMORY:
            return None
        return cls(control=options.control, action=options.action, fps=options.fps)

    def reset(self) -> None:
        """Starts an episode: nothing has been tried."""
        self._tries = FeltTries(self._fps)

    @property
    def events(self) -> list[FeltEvent]:
        """Felt tries in the memory, the latest first."""
        return self._tries.events[: -NUM_TRIES - 1 : -1]

    def after(self, state: ArrayLike, action: ArrayLike, following: ArrayLike) -> None:
        """Advances by one step.

        Args:
            state: (8,) or (24,) before the action, as observed.
            action: (A,) that was sent.
            following: state after it.
        """
        hand, sent = hand_of(state), np.asarray(action, np.float32)
        goal = pose_of_delta(sent, hand.tcp_in_base) if self._is_delta else sent
        self._tries.after(hand, HandPose(*pose_from_vector(goal)), hand_of(following))

    def numbers(self) -> NDArray[np.float32]:
        """Returns the numbers (96,) of `MEMORY_NAMES`."""
        rows = np.zeros((NUM_TRIES, len(TRY_NAMES)), np.float32)
        for row, event in zip(rows, self.events, strict=False):
            motions = np.clip([*event.commanded, *event.measured], -MAX_MOTION, MAX_MOTION)
            times = min(event.times, MAX_TIMES) / MAX_TIMES
            row[:] = [1.0, *pose_vector(event.start, 0.0)[:-1], *motions, event.blocked, times]
        return rows.reshape(-1)

    def sentence(self) -> str:
        """Returns the sentence that follows an instruction, the earliest try first; empty if nothing was tried."""
        tries = "; ".join(map(described, reversed(self.events)))
        return f"{SO_FAR}{tries}." if tries else ""


def hand_of(state: ArrayLike) -> HandPose:
    """Returns the measured hand of a state (8,) or (24,), see `contract.control.STATES`."""
    values = np.asarray(state, np.float32).astype(np.float64)
    if len(values) == len(STATES[FULL]):
        return HandPose(*pose_from_vector(values[:ACTION_DIM]))
    return HandPose(transform(values[:3], matrix_from_rotation_vector(values[3:6])), float(values[6]) / FINGER_TRAVEL)


def described(event: FeltEvent) -> str:
    """Returns a felt try in words, from its motion alone: ``turned left twice: blocked``."""
    times = TIMES.get(event.times, f" {event.times} times")
    return f"{_verb(event)}{times}: {'blocked' if event.blocked else 'moved'}"


def _verb(event: FeltEvent) -> str:
    """Returns what the hand was commanded to do.

    Right is clockwise about the tool's approach, seen from the hand. Other directions are the robot base's.
    """
    x, y, forward, _, _, turn = event.commanded
    if abs(turn) * MOTION_UNITS[5] > MIN_TURN_RAD and abs(turn) > abs(forward):
        return f"turned {'right' if turn > 0 else 'left'}"
    if abs(forward) >= max(abs(x), abs(y)):
        return "pushed" if forward > 0 else "pulled"
    along = event.start[:3, :3] @ event.commanded[:3]
    names = (("away", "closer"), ("left", "right"), ("up", "down"))
    axis = int(np.abs(along).argmax())
    return f"moved {names[axis][0 if along[axis] > 0 else 1]}"


def stored_memory(
    states: NDArray[np.float32], actions: NDArray[np.float32], memory: Memory
) -> Iterator[tuple[NDArray[np.float32], str]]:
    """Yields the numbers (96,) and the sentence of each row of an episode.

    Args:
        states: (T, 8) or (T, 24) of its rows.
        actions: (T, A) that were sent after each; the last one is not used.
        memory: of the dataset's control.
    """
    memory.reset()
    yield memory.numbers(), memory.sentence()
    for row in range(len(states) - 1):
        memory.after(states[row], actions[row], states[row + 1])
        yield memory.numbers(), memory.sentence()


def with_row_tasks(record: dict[str, Any], columns: Mapping[str, NDArray[Any]], options: Any) -> dict[str, Any]:
    """Returns an episode's record with its instruction, and with ``tasks``, one a row, if the memory is text.

    ``columns`` are the episode's rows, and ``options`` the `EnvironmentOptions`.
    """
    instruction = instruction_of(record["task"])
    memory = Memory.of(options)
    if memory is None or options.memory != TEXT or not columns:
        return {**record, "task": instruction}
    stored = stored_memory(columns[STATE], columns[EXECUTED], memory)
    return {**record, "task": instruction, "tasks": [instruction + sentence for _, sentence in stored]}
