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
"""Standard deviation of a pre-grasp about its nominal pose [m, rad], clipped at two. The grasp is exact. The approach
varies, so that a policy learns to correct the last 10 cm from its observation."""
APPROACHES = ((1.0, 1.0), (0.7, 0.5), (0.4, 0.0))
"""Shares of `PRE_GRASP` and of the jitter, one pair per approach, each nearer to the part than the last. Far away,
at the end of the arm's reach, a path may not exist although both of its ends are reachable."""
HELD_WITHIN_M, HELD_WITHIN_RAD = 0.025, 0.3
"""A closed hand within this distance and angle of a grasp holds the part."""
AT_GRASP_M, AT_GRASP_RAD = 0.012, 0.12
"""An open hand within this distance and angle of a grasp closes at once. If it had to reach the exact grasp first, a
hand that is always a few millimetres off would never close."""
STRAIGHT_WITHIN_M, STRAIGHT_WITHIN_RAD = 0.035, 0.35
"""An open hand within `PRE_GRASP` of a grasp, and this close to its approach line, goes straight to the grasp."""
NEAR_PART = 0.06
"""A hand this close to a grasp [m] backs off before any other motion."""
AJAR_POSITION = {"revolute": 0.07, "prismatic": 0.006, "fixed": np.inf}
"""A joint beyond this position [rad or m] is not locked; a blocked joint appears to move less."""
HAND_COMPLIANCE = {"revolute": 0.045, "prismatic": 0.004, "fixed": 0.0}
"""Apparent motion of a blocked joint before the hand feels a stall [rad or m]."""
MIN_MOVED = 0.003
"""A joint this far from rest [rad or m] has moved."""
OPEN_SHARE = 0.8
"""Share of the opening path at which an expert is done; well past the success threshold."""
MAX_PULLS = 8
"""Further pulls of a part that followed but stalled before it was open; each opens a full-size door by 0.1 rad."""
MAX_GRIPS = 4
"""Grasps of a part before an expert tries something else."""

Frames = Generator[Goal, Feedback, None]
Attempt = Generator[Goal, Feedback, bool]


class Opening(enum.Enum):
    """Result of a try to open: fully open, blocked, partly open, or grip lost."""

    DONE = enum.auto()
    BLOCKED = enum.auto()
    AJAR = enum.auto()
    LOST = enum.auto()


@dataclass
class Hand:
    """Hand of one episode: tracks the object's joints and moves to parts where they are now.

    Attributes:
        rng: random numbers of the expert's choices.
        trials: tries of a blocked motion before another is chosen (paper's Table 2; the paper uses 1).
        positions: joint -> position [rad or m]: seen at the start, then measured by the hand that holds its part.
        feedback: latest feedback. Needed at the start if the hand may be closed or near a part.
        home: (4, 4) pose at the start, if known; the arm can reach any goal from there.
        belief: results of tries made before this expert took over.
        parts: all parts, if the expert takes over and the hand may be near any of them; None if the hand starts open
            and away from every part.
        settles: joint -> position after its moved part is released [rad or m]: a lever springs back, a lid falls shut,
            a portafilter falls out.
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
        """Returns the last known position of a joint [rad or m]."""
        return self.positions.get(joint, 0.0)

    def is_ajar(self, part: PartAnnotation, joint: str) -> bool:
        """Returns whether a joint is too far from rest to be locked."""
        return abs(self.at(joint)) > AJAR_POSITION[part.motion(joint).kind]

    def move_to(self, pose: NDArray[np.float64], gripper: float, phase: Phase) -> Frames:
        """Yields one key frame and stores its feedback."""
        self.feedback = yield Goal(pose, gripper, phase)

    def clear(self) -> Frames:
        """Releases and backs off, if the expert takes over a hand that holds something or is near a part.

        An open hand only backs off: an expert that is restarted at each key frame would otherwise open it forever.
        """
        parts, self.parts = self.parts or {}, None
        near = any(map(self._is_near, parts.values()))
        if parts and self.feedback.gripper < OPEN_HAND and (near or not self.empty):
            yield from self.release()
        elif near:
            self.positions.update(self._settled())
            yield from self.back_off(1.0)

    def is_closed_near(self, part: PartAnnotation) -> bool:
        """Returns whether the hand is not open, and close to a part."""
        return self.feedback.gripper < OPEN_HAND and self._is_near(part)

    def _is_near(self, part: PartAnnotation) -> bool:
        away, _ = self._beside(part.moved(self.positions))
        return float(np.linalg.norm(away)) < NEAR_PART

    def holds(self, part: PartAnnotation) -> bool:
        """Returns whether the hand already holds a part when the expert takes over."""
        away, turned = self._beside(part.moved(self.positions))
        full = EMPTY_HAND <= self.feedback.gripper < OPEN_HAND
        return full and float(np.linalg.norm(away)) < HELD_WITHIN_M and turned < HELD_WITHIN_RAD

    def _beside(self, pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Returns the hand's position (3,) [m] in the frame of a pose (4, 4), and the angle between both [rad]."""
        here = self.feedback.tcp_in_base
        return pose[:3, :3].T @ (here[:3, 3] - pose[:3, 3]), angle_between(pose[:3, :3], here[:3, :3])

    def grasp(self, part: PartAnnotation) -> Attempt:
        """Moves to a part where it is now and closes the fingers. Returns True if the hand holds something."""
        if self.parts is not None and self.holds(part):
            self.parts = None
            return True
        yield from self._approach(part, 1.0)
        yield from self.move_to(part.moved(self.positions), 0.0, Phase.GRASP)
        return not self.empty

    def press(self, part: PartAnnotation) -> Frames:
        """Moves to a part with closed fingers, to push it."""
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
                continue  # from elsewhere the path to the grasp would pass through the part
            yield from self.move_to(grasp, gripper, Phase.APPROACH)
            if not self.feedback.failed:
                return

    def _go_on(self, grasp: NDArray[np.float64], gripper: float) -> Attempt:
        """Continues an approach begun before the takeover. Returns True if the hand is then at the grasp."""
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
        """Moves ``joint`` of a held part to ``position`` [rad or m] and measures how far it came; other joints stay."""
        self._sent = (joint, position)
        yield from self.move_to(part.moved({**self.positions, joint: position}), 0.0, phase)
        if not self.empty:
            self.positions[joint] = self.followed(part, joint)

    def followed(self, part: PartAnnotation, joint: str) -> float:
        """Returns the position of ``joint`` [rad or m], measured by the hand that holds its part."""
        at_zero = part.moved({**self.positions, joint: 0.0})
        return part.motion(joint).followed(at_zero, self.feedback.tcp_in_base)

    def open(self, part: PartAnnotation, joint: str, path: Sequence[float]) -> Generator[Goal, Feedback, Opening]:
        """Moves a held part until ``joint`` is open; grasps it again if the grip is lost.

        ``path`` are rising joint positions [rad or m], one key frame each; the first one ahead of the joint is the try.
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
        """Releases a part and grasps it where it is. Returns True if the hand then holds something."""
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
        """Returns possible joint positions after a release, the likeliest first, from those felt before it."""
        likely = dict(self.positions)
        if self._sent is None:
            return [likely]
        joint, goal = self._sent
        if joint in self.settles:
            others = [felt.get(joint, 0.0)]
        elif torn:
            others = [(self.at(joint) + goal) / 2, goal, 0.0]
        else:  # a stalled hand has given way a little
            others = [self.at(joint) - np.sign(goal) * HAND_COMPLIANCE[part.motion(joint).kind]]
        return [likely, *({**likely, joint: each} for each in others)]

    def slip(self, part: PartAnnotation, joint: str) -> float:
        """Returns how far [m] the hand has slipped along the part, from its grasp at the joint's current position."""
        there = part.moved({**self.positions, joint: self.followed(part, joint)})
        return float(np.linalg.norm(self.feedback.tcp_in_base[:3, 3] - there[:3, 3]))

    def _open_in_one_grip(
        self, part: PartAnnotation, joint: str, path: Sequence[float]
    ) -> Generator[Goal, Feedback, Opening]:
        min_motion = FOLLOWED * path[0]
        ahead = [position for position in path if position > self.at(joint) + min_motion] or [path[-1]]
        for number, position in enumerate(ahead):
            start = self.at(joint)
            trying = number == 0 and not self.is_ajar(part, joint)
            yield from self.move(part, joint, position, Phase.TRY if trying else Phase.OPEN)
            if self.empty:
                return Opening.LOST
            # Checked at each step: a slipping grip leaves the joint behind.
            if self.feedback.failed and self.at(joint) - start < min_motion:
                if self.is_ajar(part, joint):
                    break  # heavy, not locked: keep pulling from here
                self.positions[joint] = start  # a blocked joint has not moved; the hand gave way
                return Opening.BLOCKED
        for _ in range(MAX_PULLS):  # repeated pulls open a stiff joint farther
            if self.empty:
                return Opening.LOST
            if not self.feedback.failed:
                break
            yield from self.move(part, joint, path[-1], Phase.OPEN)
        return Opening.DONE if self.is_open(joint, path) else Opening.AJAR

    def is_open(self, joint: str, path: Sequence[float]) -> bool:
        """Returns whether a joint is near the end of its opening path."""
        return self.at(joint) > OPEN_SHARE * path[-1]

    def _jitter(self, spread: float) -> NDArray[np.float64]:
        shift = spread * JITTER_POSITION * np.clip(self.rng.normal(size=3), -2, 2)
        turn = spread * JITTER_ROTATION * np.clip(self.rng.normal(size=3), -2, 2)
        return transform(shift, Rotation.from_rotvec(turn).as_matrix())


def before(grasp: NDArray[np.float64], distance: float = 1.0) -> NDArray[np.float64]:
    """Returns the (4, 4) pose before a grasp, back along its approach by a share of `PRE_GRASP`."""
    return grasp @ transform((0.0, 0.0, -distance * PRE_GRASP))
