"""Tries: pushes of the arm on the joints of an object, tracked tick by tick.

One definition for simulator, labels, limits, logs and metrics, for every kind of control. A *try* is a maximal stretch
of control ticks in which the arm pushes one joint in one direction. It ends when the arm lets go, turns back, or rests
after the joint was blocked or while it tries another joint. It *failed* if the joint did not move. A turn that moves a
joint to its stop is one try, and it succeeded.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

from lerobot_adamanip.contract.keyframes import KeyFrameLabels

MIN_JOINT_MOTION = {"revolute": 0.02, "prismatic": 0.001}
"""Least motion of a joint that counts as motion [rad, m]."""
MIN_TICK_MOTION = {"revolute": 5e-4, "prismatic": 2.5e-5}
"""Least motion of a joint in one control tick that counts as motion [rad, m]."""
MIN_SENT_SHARE = 0.5
"""Share of a joint's motion that the arm must command; with less, a spring or gravity moves the joint."""
REST_TICKS = 5
"""Control ticks without a push after which a stretch of pushing is interrupted."""


@dataclass(frozen=True)
class Push:
    """Push of the arm on a joint that it touches, in one control tick.

    Attributes:
        sent: motion of the arm's target in this tick, along the joint's motion [rad or m].
        direction: sign of the direction in which the arm is held back by the joint; 0 if it is not.
        is_meant: whether the arm was also sent in that direction; a try starts only then.
    """

    sent: float = 0.0
    direction: int = 0
    is_meant: bool = False


@dataclass(eq=False)
class Try:
    """A try at one joint.

    Attributes:
        joint: index in the mechanism's `joints`.
        direction: sign of the push.
        moved: largest motion of the joint in this direction [rad or m].
        failed: whether the joint did not move by `MIN_JOINT_MOTION`; final once the try has ended.
        ticks: number of control ticks with a push.
    """

    joint: int
    direction: int
    moved: float = 0.0
    failed: bool = True
    ticks: int = 0


@dataclass
class _JointState:
    """Progress of one joint: its present try, and the motion since the latest one ended.

    Attributes:
        kind: kind of the joint.
        position: position at the latest tick [rad or m].
        start: where the present try, or the motion without a try, started.
        sent: motion of the arm's target since then, or since the joint was farthest, along its motion [rad or m].
        quiet: control ticks since the latest push.
        still: control ticks without contact and without motion.
    """

    kind: str
    position: float
    start: float
    sent: float = 0.0
    quiet: int = 0
    still: int = 0
    current: Try | None = None


@dataclass
class TryTracker:
    """Follows the tries of one episode.

    Args:
        kinds: name -> ``revolute`` or ``prismatic``, in the order of the mechanism's `joints`.
        positions: joint positions at the start [rad or m].

    Attributes:
        tries: all tries so far, by their start.
    """

    kinds: Mapping[str, str]
    positions: Mapping[str, float]
    tries: list[Try] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Starts at the given positions."""
        self._states = {
            name: _JointState(kind, self.positions[name], self.positions[name]) for name, kind in self.kinds.items()
        }

    def sequence(self, *, ended: bool = False) -> tuple[tuple[int, int, bool], ...]:
        """Returns joint, direction and failure of each try; with ``ended`` without a failed try that has not ended."""
        present = [state.current for state in self._states.values()] if ended else []
        tries = [each for each in self.tries if not (each.failed and each in present)]
        return tuple([(each.joint, each.direction, each.failed) for each in tries])

    def at_rest(self) -> frozenset[str]:
        """Returns the joints that no try moves and that do not need the arm to stay: at zero, or without contact."""
        return frozenset(
            name
            for name, state in self._states.items()
            if state.current is None
            and (abs(state.position) < MIN_JOINT_MOTION[state.kind] or state.still > REST_TICKS)
        )

    def update(self, pushes: Mapping[str, Push], positions: Mapping[str, float]) -> None:
        """Advances by one control tick.

        Args:
            pushes: push on each joint that the arm touches.
            positions: joint positions at the end of the tick [rad or m].
        """
        for joint, (name, state) in enumerate(self._states.items()):
            self._advance(joint, state, pushes.get(name), positions[name])

    def _advance(self, joint: int, state: _JointState, push: Push | None, position: float) -> None:
        motion, state.position = position - state.position, position
        moves = abs(motion) > MIN_TICK_MOTION[state.kind]
        state.still = 0 if push is not None or moves else state.still + 1
        if state.current is not None:
            self._continue(state, state.current, push, motion if moves else 0.0)
        if state.current is None:
            self._start(joint, state, push)

    def _continue(self, state: _JointState, current: Try, push: Push | None, motion: float) -> None:
        way = current.direction
        if push is not None and (push.direction == way or motion * way > 0):
            state.quiet, current.ticks = 0, current.ticks + 1
        else:
            state.quiet += 1
        state.sent += 0.0 if push is None else push.sent
        reached = way * (state.position - state.start)
        if push is not None and reached > current.moved:
            current.moved, state.sent = reached, 0.0
            current.failed = reached < MIN_JOINT_MOTION[state.kind]
        back = current.moved - reached
        has_turned = back > MIN_JOINT_MOTION[state.kind] and -way * state.sent > MIN_SENT_SHARE * back
        turns_back = push is not None and (has_turned or (push.is_meant and push.direction == -way))
        is_other = any(each.current is not None and each is not state for each in self._states.values())
        if turns_back or (state.quiet > REST_TICKS and (push is None or current.failed or is_other)):
            state.current = None
            state.start = state.start + way * current.moved if turns_back else state.position
            state.sent = state.sent if turns_back else 0.0

    def _start(self, joint: int, state: _JointState, push: Push | None) -> None:
        if push is None:
            state.start, state.sent = state.position, 0.0
            return
        state.sent += push.sent
        shift = state.position - state.start
        has_moved = abs(shift) >= MIN_JOINT_MOTION[state.kind]
        is_moved = has_moved and state.sent / shift > MIN_SENT_SHARE
        if push.is_meant or is_moved:
            way = push.direction if push.is_meant else (1 if shift > 0 else -1)
            moved = max(0.0, way * shift)
            state.current = Try(joint, way, moved, moved < MIN_JOINT_MOTION[state.kind], 1)
            state.quiet, state.sent = 0, 0.0
            self.tries.append(state.current)
        elif has_moved:  # by itself: a spring, gravity or its own inertia
            state.start, state.sent = state.position, 0.0


OPENING_TICKS = 15
"""Control ticks in which fingers open. A push in this time belongs to the key frame before."""


class KeyFrameLabeler:
    """Labels key frames, or dense steps, by the tries of a `TryTracker`, one after the other.

    Args:
        tracker: tracker of the episode.
        is_dense: whether steps are too short to hold a whole try: then a step has the label of a try that continues.

    Attributes:
        labels: labels of the latest step.
    """

    def __init__(self, tracker: TryTracker, *, is_dense: bool = False) -> None:
        self._tracker, self._is_dense = tracker, is_dense
        self._positions = dict(tracker.positions)
        self._ticks: list[int] = []
        self._failed = 0
        self.labels = KeyFrameLabels()

    def after_key_frame(self, positions: Mapping[str, float], *, opens: bool = False) -> KeyFrameLabels:
        """Labels a finished key frame by its longest try.

        Args:
            positions: joint positions at its end [rad or m].
            opens: whether the hand was open at its end. A try that continues from before then belongs to the key frame
                before, unless it lasts more than `OPENING_TICKS`.
        """
        tracker = self._tracker
        ticks = [each.ticks for each in tracker.tries]
        pairs = itertools.zip_longest(ticks, self._ticks, fillvalue=0)
        length, number = max(((now - before, number) for number, (now, before) in enumerate(pairs)), default=(0, 0))
        self.labels = KeyFrameLabels(trial=self._failed)
        goes_on = number < len(self._ticks) and not self._is_dense
        if length > (OPENING_TICKS if goes_on and opens else REST_TICKS if goes_on else 0):
            longest = tracker.tries[number]
            name = list(tracker.kinds)[longest.joint]
            progress = longest.direction * (positions[name] - self._positions[name])
            self.labels = KeyFrameLabels(
                longest.joint, longest.failed, progress, self._failed, longest.direction, number
            )
        self._positions, self._failed = dict(positions), sum(each.failed for each in tracker.tries)
        self._ticks = ticks
        return self.labels
