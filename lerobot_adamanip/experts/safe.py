"""Experts for the safe (paper, appendix "Adaptive Manipulation Sequence").

Pull the door. If that fails, turn the knob: choose a direction at random, take the other one if it fails. Then pull
again. The adaptive expert knows the annotated part poses and what the arm felt; the static one also the hidden state.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lerobot_adamanip.experts.base import PRE_GRASP, Feedback, Goal, KeyFrames, Phase
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.rotations import transform

JITTER_POSITION, JITTER_ROTATION = 0.012, 0.06
"""Standard deviation of a pre-grasp about its nominal pose [m, rad], cut at two. Only the grasp has to be exact; what
leads there varies, so that a policy learns to correct the last 10 cm by what it sees."""
PULL_ANGLES = tuple(np.deg2rad((10.0, 22.0, 33.0, 42.0)))
"""Door angles of the pulls [rad]; the first is the try."""
TURN_STEP = np.deg2rad(40.0)
"""Knob angle of one key frame [rad]."""
MAX_TURNS = 4
"""Key frames in one direction; no knob turns farther than 4 x 40 degrees."""
EMPTY_HAND = 0.05
"""Finger opening below which nothing is between them: the grip was torn off, which a door that gives does not do."""
MAX_ROUNDS = 3
"""Times the knob is visited before giving up."""

Frames = Generator[Goal, Feedback, bool]


@dataclass
class SafeExpert:
    """One episode's expert: where it is, what it has felt, how often it has tried.

    Attributes:
        handle, knob: annotations in the robot's base frame.
        rng: decides which direction is tried first.
        trials: how often a door that does not move is pulled before the knob is tried (paper's Table 2; 1 is theirs).
    """

    handle: PartAnnotation
    knob: PartAnnotation
    rng: np.random.Generator
    trials: int = 1
    trial: int = 0
    knob_angle: float = 0.0
    felt: Feedback = field(init=False)

    def adaptive(self) -> KeyFrames:
        """Trial and error, as control flow."""
        self.felt = yield from self._hold(self.handle, 0.0)
        opened = yield from self._pull()
        for _ in range(self.trials - 1):
            if not opened:
                opened = yield from self._pull()
        for _ in range(MAX_ROUNDS):
            if opened:
                return
            yield from self._let_go()
            first = int(self.rng.choice([-1, 1]))
            yield from self._unlock((first, -first))
            yield from self._let_go()
            self.felt = yield from self._hold(self.handle, 0.0)
            opened = yield from self._pull()

    def static(self, *, locked: bool, direction: int) -> KeyFrames:
        """Optimal under full observation: straight to what opens it."""
        if locked:
            yield from self._unlock((direction,))
            yield from self._let_go()
        self.felt = yield from self._hold(self.handle, 0.0)
        yield from self._pull()

    def _hold(self, part: PartAnnotation, angle: float) -> Generator[Goal, Feedback, Feedback]:
        grasp = part.turned(angle)
        before = grasp @ transform((0.0, 0.0, -PRE_GRASP)) @ self._jitter()
        yield Goal(before, 1.0, Phase.APPROACH, self.trial)
        yield Goal(grasp, 1.0, Phase.APPROACH, self.trial)
        return (yield Goal(grasp, 0.0, Phase.GRASP, self.trial))

    def _jitter(self) -> NDArray[np.float64]:
        shift = JITTER_POSITION * np.clip(self.rng.normal(size=3), -2, 2)
        turn = JITTER_ROTATION * np.clip(self.rng.normal(size=3), -2, 2)
        return transform(shift, Rotation.from_rotvec(turn).as_matrix())

    def _let_go(self) -> Generator[Goal, Feedback, None]:
        self.felt = yield Goal(self.felt.tcp_in_base, 1.0, Phase.RELEASE, self.trial)
        back = self.felt.tcp_in_base @ transform((0.0, 0.0, -PRE_GRASP))
        self.felt = yield Goal(back, 1.0, Phase.RELEASE, self.trial)

    def _pull(self) -> Frames:
        """Pulls the held handle along its arc; True if the door came along."""
        for number, angle in enumerate(PULL_ANGLES):
            phase = Phase.TRY if number == 0 else Phase.OPEN
            self.felt = yield Goal(self.handle.turned(angle), 0.0, phase, self.trial)
            blocked = number == 0 and self.felt.failed and self._door_followed() < 0.5 * angle
            if blocked or self.felt.gripper < EMPTY_HAND:
                self.trial += 1
                return False
        return True

    def _unlock(self, directions: tuple[int, ...]) -> Generator[Goal, Feedback, None]:
        """Turns the knob until it stops, in the first direction that it follows."""
        self.felt = yield from self._hold(self.knob, self.knob_angle)
        for direction in directions:
            start = self.knob_angle
            for turn in range(1, MAX_TURNS + 1):
                goal = self.knob.turned(start + direction * turn * TURN_STEP)
                self.felt = yield Goal(goal, 0.0, Phase.UNLOCK, self.trial)
                if self.felt.failed:
                    break
            self.knob_angle = self._knob_followed()
            if direction * (self.knob_angle - start) > 0.5 * TURN_STEP:
                return
            self.trial += 1

    def _door_followed(self) -> float:
        """Door angle [rad] as the held handle tells it."""
        return _angle_about(self.handle, self.handle.grasp[:3, 3], self.felt.tcp_in_base[:3, 3])

    def _knob_followed(self) -> float:
        """Knob angle [rad] as the hand's rotation tells it."""
        x_before = self.knob.grasp[:3, 0] + self.knob.axis_point
        x_now = self.felt.tcp_in_base[:3, 0] + self.knob.axis_point
        return _angle_about(self.knob, x_before, x_now)


def _angle_about(part: PartAnnotation, before: NDArray[np.float64], now: NDArray[np.float64]) -> float:
    """Signed angle [rad] about the part's axis between two points (3,)."""
    first, second = before - part.axis_point, now - part.axis_point
    first = first - part.axis * (part.axis @ first)
    second = second - part.axis * (part.axis @ second)
    return float(np.arctan2(part.axis @ np.cross(first, second), first @ second))


def adaptive_safe(parts: Mapping[str, PartAnnotation], rng: np.random.Generator, *, trials: int = 1) -> KeyFrames:
    """Returns the adaptive expert's key frames. It never learns the hidden state."""
    return SafeExpert(parts["handle"], parts["knob"], rng, trials).adaptive()


def static_safe(
    parts: Mapping[str, PartAnnotation], rng: np.random.Generator, *, hidden: Mapping[str, bool | int | float]
) -> KeyFrames:
    """Returns the static expert's key frames; ``hidden`` holds ``locked`` and ``direction``."""
    expert = SafeExpert(parts["handle"], parts["knob"], rng)
    return expert.static(locked=bool(hidden["locked"]), direction=int(hidden["direction"]))
