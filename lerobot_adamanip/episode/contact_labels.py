"""Labels of key frames: which joint a key frame tried, how far it moved, and whether the try failed.

One definition for simulator, datasets, logs and reports. In a *try* the hand is closed and at a part before the key
frame, stays closed, and is sent far enough along one of the part's joints. An empty closed hand can only push.
Approaches, grasps, releases and backing off from a button are not tries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.keyframes import EMPTY_HAND, FOLLOWED, Feedback, KeyFrameLabels
from lerobot_adamanip.contract.rotations import angle_between
from lerobot_adamanip.objects import ArticulatedObject, Motion, PartAnnotation

Pose = NDArray[np.float64]

NEAR_PART = 0.06
"""A tool within this distance of a part's grasp is at the part [m]."""
FAR_ENOUGH_DISTANCE, FAR_ENOUGH_ANGLE = 0.008, 0.1
"""Least commanded motion along a joint that is a try [m, rad]; a grip that settles moves less."""
MIN_JOINT_MOTION = {"revolute": 0.01, "prismatic": 0.0005}
"""Least motion of a joint that counts as following [rad, m], however short the commanded motion."""
CLOSED = 0.5
"""A gripper commanded below this opening is closed."""
METRES_PER_RADIAN = 0.1
"""Weight of one radian in the distance between a goal and a joint's motion [m/rad]."""


@dataclass(frozen=True)
class JointRange:
    """Kind and nominal limits of a joint [rad or m]; no hidden state."""

    kind: str
    lower: float
    upper: float

    def room(self, position: float, sent: float) -> float:
        """Returns ``sent``, clipped so that ``position`` + ``sent`` stays in the nominal range."""
        return float(np.clip(position + sent, min(self.lower, position), max(self.upper, position)) - position)


@dataclass(frozen=True)
class Try:
    """Motion of a hand at a part that is meant to move one of its joints.

    Attributes:
        part: name of the part.
        joint: name of the joint.
        kind: of the joint.
        sent: commanded motion along the joint, signed [rad or m].
        way: ``sent`` clipped to the joint's nominal range, because a button is commanded past its stop.
    """

    part: str
    joint: str
    kind: str
    sent: float
    way: float

    def progress(self, before: float, after: float) -> float:
        """Returns how far the joint moved in the commanded direction, from its positions [rad or m]."""
        return float(np.sign(self.sent)) * (after - before)

    def failed(self, progress: float) -> bool:
        """Returns whether the joint covered less than half of the way, or less than `MIN_JOINT_MOTION`."""
        return progress < max(FOLLOWED * abs(self.way), MIN_JOINT_MOTION[self.kind])


def present_motions(part: PartAnnotation, joints: Mapping[str, float]) -> list[Motion]:
    """Returns a part's motions, their axes moved by the joints before them in the chain [rad or m]."""
    frame, motions = np.eye(4), []
    for motion in part.motions:
        motions.append(motion.in_frame(frame))
        frame = frame @ motion.applied(np.eye(4), joints.get(motion.joint, 0.0))
    return motions


def meant(motions: Sequence[Motion], start: Pose, goal: Pose) -> Motion:
    """Returns the motion that takes a hand from ``start`` nearest to ``goal``, both (4, 4)."""

    def missed(motion: Motion) -> float:
        there = motion.applied(start, motion.followed(start, goal))
        away = float(np.linalg.norm(there[:3, 3] - goal[:3, 3]))
        return away + METRES_PER_RADIAN * angle_between(there[:3, :3], goal[:3, :3])

    return min(motions, key=missed)


def part_at(tool: Pose, parts: Mapping[str, PartAnnotation], joints: Mapping[str, float]) -> PartAnnotation | None:
    """Returns the part near a tool pose (4, 4), with the object's joints as given; None if there is none."""
    away = [(float(np.linalg.norm(tool[:3, 3] - part.moved(joints)[:3, 3])), name) for name, part in parts.items()]
    distance, nearest = min(away, default=(np.inf, ""))
    return parts[nearest] if distance < NEAR_PART else None


def _far_enough(before: Feedback, there: Pose) -> bool:
    """Returns whether a motion ``there`` along a joint can move it: far enough, and forward if the hand is empty."""
    start = before.tcp_in_base
    shift = there[:3, 3] - start[:3, 3]
    if before.gripper < EMPTY_HAND:
        return float(shift @ start[:3, 2]) > FAR_ENOUGH_DISTANCE
    turn = angle_between(there[:3, :3], start[:3, :3])
    return bool(np.linalg.norm(shift) > FAR_ENOUGH_DISTANCE or turn > FAR_ENOUGH_ANGLE)


class TryLabeler:
    """Labels the key frames of one episode, one after the other.

    Args:
        obj: the object.
        joints: names as in `Mechanism.joints`; the joint that opens comes first.
        parts: annotations, robot base frame, joints at zero.
        start: feedback at the episode's start.
        positions: joint positions at the start [rad or m].

    Attributes:
        labels: of the latest key frame.
        history: of all so far.
        first_part: name of the part of the first try; None before it.
    """

    def __init__(
        self,
        obj: ArticulatedObject,
        joints: Sequence[str],
        parts: Mapping[str, PartAnnotation],
        start: Feedback,
        positions: Mapping[str, float],
    ) -> None:
        moving = [link.joint for link in obj.links if link.joint is not None and link.joint.kind != "fixed"]
        self._ranges = {joint.name: JointRange(joint.kind, *joint.limits) for joint in moving}
        self._joints, self._parts = tuple(joints), parts
        self._felt, self._positions, self._was_closed = start, dict(positions), False
        self.labels = KeyFrameLabels()
        self.history: list[KeyFrameLabels] = []
        self.first_part: str | None = None

    def after_key_frame(
        self, goal: Pose, gripper: float, feedback: Feedback, positions: Mapping[str, float]
    ) -> KeyFrameLabels:
        """Labels a finished key frame.

        Args:
            goal: (4, 4) commanded tool pose, robot base frame [m].
            gripper: commanded opening.
            feedback: at its end.
            positions: joint positions at its end [rad or m].
        """
        trial = self.labels.trial + self.labels.failed
        tried = self._find_try(goal) if self._was_closed and gripper < CLOSED else None
        self.labels = KeyFrameLabels(trial=trial)
        if tried is not None:
            self.first_part = self.first_part or tried.part
            progress = tried.progress(self._positions[tried.joint], positions[tried.joint])
            joint, failed = self._joints.index(tried.joint), tried.failed(progress)
            self.labels = KeyFrameLabels(joint, failed, progress, trial, tried.sent)
        self.history.append(self.labels)
        self._felt, self._positions, self._was_closed = feedback, dict(positions), gripper < CLOSED
        return self.labels

    def _find_try(self, goal: Pose) -> Try | None:
        """Returns the try of a key frame with a closed hand; None if it tried nothing."""
        start = self._felt.tcp_in_base
        part = part_at(start, self._parts, self._positions)
        if part is None:
            return None
        motion = meant(present_motions(part, self._positions), start, goal)
        sent = motion.followed(start, goal)
        if not _far_enough(self._felt, motion.applied(start, sent)):
            return None
        joint, position = self._ranges[motion.joint], self._positions[motion.joint]
        way, least = joint.room(position, sent), MIN_JOINT_MOTION[joint.kind]
        if abs(way) < least and abs(position) < least:
            return None  # closing a shut part is no try
        return Try(part.name, motion.joint, joint.kind, sent, way)
