"""Primitives of every expert: approach, grasp, press, release, move and open a part, and track its joints."""

from __future__ import annotations

import enum
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.keyframes import (
    EMPTY_HAND,
    FOLLOWED,
    OPEN_HAND,
    PRE_GRASP,
    Feedback,
    Goal,
    Outcome,
    Phase,
)
from lerobot_adamanip.contract.rotations import angle_between, transform
from lerobot_adamanip.experts.belief import Belief, Parts
from lerobot_adamanip.objects import PartAnnotation

JITTER_POSITION, JITTER_ROTATION = 0.012, 0.06
"""Standard deviation of a pre-grasp about its nominal pose [m, rad], cut at two. Only the grasp has to be exact; the
approach varies, so that a policy learns to correct the last 10 cm from its observation."""
APPROACHES = ((1.0, 1.0), (0.7, 0.5), (0.4, 0.0))
"""Share of `PRE_GRASP`, and of the jitter, of one approach after the other: the farther away, the nearer to the end of
the arm's reach, where a path may not exist though both of its ends are within reach."""
HELD_WITHIN_M, HELD_WITHIN_RAD = 0.025, 0.3
"""A closed hand within this distance and angle of a grasp holds the part."""
AT_GRASP_M, AT_GRASP_RAD = 0.012, 0.12
"""An open hand within this distance and angle of a grasp only closes. Sent to the exact grasp first, a hand that is
always a few millimetres off would never close."""
STRAIGHT_WITHIN_M, STRAIGHT_WITHIN_RAD = 0.035, 0.35
"""An open hand within `PRE_GRASP` of a grasp, and this close to its approach line, goes straight to the grasp."""
NEAR_PART = 0.06
"""A hand this close to a grasp [m] has to back off before it goes anywhere else."""
AJAR_POSITION = {"revolute": 0.07, "prismatic": 0.006, "fixed": np.inf}
"""A joint beyond this position [rad or m] is not locked: a blocked joint moves less in the hand."""
HAND_COMPLIANCE = {"revolute": 0.045, "prismatic": 0.004, "fixed": 0.0}
"""How far a joint seems to move before the hand feels a stall [rad or m]."""
MIN_MOVED = 0.003
"""A joint this far from rest [rad or m] has moved."""
OPEN_SHARE = 0.8
"""Share of the way to an expert's last pose at which it is done; well past the success threshold."""
MAX_PULLS = 8
"""Further pulls at a part that followed and stalled before it was open: a full-size door opens 0.1 rad with each."""
MAX_GRIPS = 4
"""Grasps of a part to open it, before an expert tries something else."""

Frames = Generator[Goal, Feedback, None]
Attempt = Generator[Goal, Feedback, bool]


class Opening(enum.Enum):
    """How a try at opening ended: all the way, not at all, part of the way, or with an empty hand."""

    DONE = enum.auto()
    BLOCKED = enum.auto()
    AJAR = enum.auto()
    LOST = enum.auto()


@dataclass
class Hand:
    """One episode's hand: what it felt, and where it has to go for a part that has moved.

    Attributes:
        rng: decides what an expert leaves to chance.
        trials: how often a motion that does not yield is repeated before another is tried (paper's Table 2; 1 is
            theirs).
        positions: joint -> where it stands [rad or m]: seen at the start, then felt by the hand that holds its part.
        feedback: the latest. At the start: of the hand as it is, if it need not be open and away from every part.
        home: (4, 4) pose at the start, where known: from there the arm gets anywhere.
        belief: what tries before this expert's own tell.
        parts: all of them, where the hand takes over from another: it may be about any of them. None where it starts
            open and away from every part.
        settles: joint -> where it goes when its part is let go after it has moved [rad or m]: a lever springs back, a
            lid falls shut, a portafilter falls out.
    """

    rng: np.random.Generator
    trials: int = 1
    positions: dict[str, float] = field(default_factory=dict)
    feedback: Feedback = field(default_factory=lambda: Feedback(np.eye(4), 1.0))
    home: NDArray[np.float64] | None = None
    belief: Belief = field(default_factory=Belief)
    parts: Parts | None = None
    settles: Mapping[str, float] = field(default_factory=dict)
    _sent: tuple[str, float] | None = None

    @property
    def empty(self) -> bool:
        """True if nothing is between closed fingers."""
        return self.feedback.gripper < EMPTY_HAND

    def at(self, joint: str) -> float:
        """Returns where a joint stands [rad or m], as far as is known."""
        return self.positions.get(joint, 0.0)

    def is_ajar(self, part: PartAnnotation, joint: str) -> bool:
        """Whether a joint stands so far from rest that nothing locks it."""
        return abs(self.at(joint)) > AJAR_POSITION[part.motion(joint).kind]

    def move_to(self, pose: NDArray[np.float64], gripper: float, phase: Phase) -> Frames:
        """One key frame."""
        self.feedback = yield Goal(pose, gripper, phase)

    def clear(self) -> Frames:
        """Lets go and backs off where this expert takes over with a hand that is closed, or about a part.

        A hand that is open already only backs off: who is asked anew at each key frame would open it for ever.
        """
        parts, self.parts = self.parts or {}, None
        here = self.feedback.tcp_in_base[:3, 3]
        near = (np.linalg.norm(part.moved(self.positions)[:3, 3] - here) < NEAR_PART for part in parts.values())
        if parts and self.feedback.gripper < OPEN_HAND:
            yield from self.release()
        elif any(near):
            self.positions.update(self._settled())
            yield from self.back_off(1.0)

    def holds(self, part: PartAnnotation) -> bool:
        """Whether the hand that is taken over holds a part already."""
        away, turned = self._beside(part.moved(self.positions))
        full = EMPTY_HAND <= self.feedback.gripper < OPEN_HAND
        return full and float(np.linalg.norm(away)) < HELD_WITHIN_M and turned < HELD_WITHIN_RAD

    def _beside(self, pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Returns where the hand is as seen from a pose (4, 4): (3,) [m], and how far it is turned from it [rad]."""
        here = self.feedback.tcp_in_base
        return pose[:3, :3].T @ (here[:3, 3] - pose[:3, 3]), angle_between(pose[:3, :3], here[:3, :3])

    def grasp(self, part: PartAnnotation) -> Attempt:
        """Goes to a part where it is now, and closes the fingers. True if there is something between them."""
        if self.parts is not None and self.holds(part):
            self.parts = None
            return True
        yield from self._approach(part, 1.0)
        yield from self.move_to(part.moved(self.positions), 0.0, Phase.GRASP)
        return not self.empty

    def press(self, part: PartAnnotation) -> Frames:
        """Goes to a part with the fingers closed, to push it."""
        yield from self._approach(part, 0.0)

    def _approach(self, part: PartAnnotation, gripper: float) -> Frames:
        grasp = part.moved(self.positions)
        if self.parts is not None and (yield from self._go_on(grasp, gripper)):
            return
        yield from self.clear()
        for number, (distance, spread) in enumerate(APPROACHES):
            if number and self.home is not None:
                yield from self.move_to(self.home, gripper, Phase.APPROACH)
            yield from self.move_to(before(grasp, distance) @ self._jitter(spread), gripper, Phase.APPROACH)
            if self.feedback.outcome is Outcome.UNREACHABLE and number < len(APPROACHES) - 1:
                continue  # from somewhere else the way to the part would lead through it
            yield from self.move_to(grasp, gripper, Phase.APPROACH)
            if not self.feedback.failed:
                return

    def _go_on(self, grasp: NDArray[np.float64], gripper: float) -> Attempt:
        """Takes an approach up where another hand has left it; True if the hand is at the grasp then."""
        away, turned = self._beside(grasp)
        as_wanted = self.feedback.gripper > OPEN_HAND if gripper else self.empty
        short = -PRE_GRASP - STRAIGHT_WITHIN_M < away[2] < STRAIGHT_WITHIN_M
        if not (as_wanted and short and np.linalg.norm(away[:2]) < STRAIGHT_WITHIN_M and turned < STRAIGHT_WITHIN_RAD):
            return False
        self.parts = None
        if np.linalg.norm(away) < AT_GRASP_M and turned < AT_GRASP_RAD:
            return True
        yield from self.move_to(grasp, gripper, Phase.APPROACH)
        return not self.feedback.failed

    def release(self) -> Frames:
        """Opens the fingers where they are, and backs off."""
        yield from self.move_to(self.feedback.tcp_in_base, 1.0, Phase.RELEASE)
        self.positions.update(self._settled())
        yield from self.back_off(1.0)

    def _settled(self) -> dict[str, float]:
        return {joint: place for joint, place in self.settles.items() if abs(self.at(joint)) > MIN_MOVED}

    def back_off(self, gripper: float) -> Frames:
        """Retreats along the approach."""
        yield from self.move_to(before(self.feedback.tcp_in_base), gripper, Phase.RELEASE)

    def move(self, part: PartAnnotation, joint: str, position: float, phase: Phase) -> Frames:
        """Moves a held part until ``joint`` is at ``position`` [rad or m], the others where they are; feels how far."""
        self._sent = (joint, position)
        yield from self.move_to(part.moved({**self.positions, joint: position}), 0.0, phase)
        if not self.empty:
            self.positions[joint] = self.followed(part, joint)

    def followed(self, part: PartAnnotation, joint: str) -> float:
        """Returns where ``joint`` stands [rad or m], as the hand that holds its part tells."""
        at_zero = part.moved({**self.positions, joint: 0.0})
        return part.motion(joint).followed(at_zero, self.feedback.tcp_in_base)

    def open(self, part: PartAnnotation, joint: str, path: Sequence[float]) -> Generator[Goal, Feedback, Opening]:
        """Takes a held part along until ``joint`` is open; about it again where the grip does not last.

        ``path`` are its positions [rad or m], rising, one key frame each; the first that lies ahead of it is the try.
        """
        for grip in range(MAX_GRIPS):
            opening = yield from self._open_in_one_grip(part, joint, path)
            if opening in (Opening.DONE, Opening.BLOCKED):
                return opening
            if grip < MAX_GRIPS - 1:
                felt, torn = dict(self.positions), self.empty
                yield from self.release()
                if self.is_open(joint, path):
                    return Opening.DONE
                yield from self._find(part, felt, torn)
        return opening

    def regrasp(self, part: PartAnnotation) -> Attempt:
        """Lets go, and takes hold of a part where it is. True if there is something in the hand then."""
        felt, torn = dict(self.positions), self.empty
        yield from self.release()
        return (yield from self._find(part, felt, torn))

    def _find(self, part: PartAnnotation, felt: dict[str, float], torn: bool) -> Attempt:
        for number, place in enumerate(self._places(part, felt, torn)):
            if number:
                yield from self.release()
            self.positions.update(place)
            if (yield from self.grasp(part)):
                return True
        self.positions.update(felt)
        return False

    def _places(self, part: PartAnnotation, felt: dict[str, float], torn: bool) -> list[dict[str, float]]:
        """Where the joints may stand after a release, the likeliest first, by what was felt before it."""
        likely = dict(self.positions)
        if self._sent is None:
            return [likely]
        joint, goal = self._sent
        if joint in self.settles:
            others = [felt.get(joint, 0.0)]
        elif torn:
            others = [(self.at(joint) + goal) / 2, goal, 0.0]
        else:  # a hand that has stalled has given way a little
            others = [self.at(joint) - np.sign(goal) * HAND_COMPLIANCE[part.motion(joint).kind]]
        return [likely, *({**likely, joint: each} for each in others)]

    def slip(self, part: PartAnnotation, joint: str) -> float:
        """Returns how far [m] the hand is from where it would hold the part, wherever ``joint`` is: along the part."""
        there = part.moved({**self.positions, joint: self.followed(part, joint)})
        return float(np.linalg.norm(self.feedback.tcp_in_base[:3, 3] - there[:3, 3]))

    def _open_in_one_grip(
        self, part: PartAnnotation, joint: str, path: Sequence[float]
    ) -> Generator[Goal, Feedback, Opening]:
        least = FOLLOWED * path[0]
        ahead = [position for position in path if position > self.at(joint) + least] or [path[-1]]
        for number, position in enumerate(ahead):
            start = self.at(joint)
            trying = number == 0 and not self.is_ajar(part, joint)
            yield from self.move(part, joint, position, Phase.TRY if trying else Phase.OPEN)
            if self.empty:
                return Opening.LOST
            # Also later on: a grip that slips leaves the joint behind.
            if self.feedback.failed and self.at(joint) - start < least:
                if self.is_ajar(part, joint):
                    break  # heavy, not locked: pulled at from where it is
                self.positions[joint] = start  # what is blocked is where it was; the hand gave way
                return Opening.BLOCKED
        for _ in range(MAX_PULLS):  # from where the hand is now, a stiff joint comes farther
            if self.empty:
                return Opening.LOST
            if not self.feedback.failed:
                break
            yield from self.move(part, joint, path[-1], Phase.OPEN)
        return Opening.DONE if self.is_open(joint, path) else Opening.AJAR

    def is_open(self, joint: str, path: Sequence[float]) -> bool:
        """Whether a joint stands as good as where `open` takes it."""
        return self.at(joint) > OPEN_SHARE * path[-1]

    def _jitter(self, spread: float) -> NDArray[np.float64]:
        shift = spread * JITTER_POSITION * np.clip(self.rng.normal(size=3), -2, 2)
        turn = spread * JITTER_ROTATION * np.clip(self.rng.normal(size=3), -2, 2)
        return transform(shift, Rotation.from_rotvec(turn).as_matrix())


def before(grasp: NDArray[np.float64], distance: float = 1.0) -> NDArray[np.float64]:
    """Returns the (4, 4) pose short of a grasp, along its approach, by a share of `PRE_GRASP`."""
    return grasp @ transform((0.0, 0.0, -distance * PRE_GRASP))
