"""An object and a hand without a simulator: joints follow the held part within the limits that the mechanism commands.

The hand has some play: it gives way a little before a stall is felt, and an expert has to tell that from motion.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import KeyFrameLabels
from lerobot_adamanip.contract.rotations import angle_between, rotation_about, transform
from lerobot_adamanip.experts import Belief, Feedback, Goal, KeyFrames, Outcome, Phase, make_expert
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.objects import ArticulatedObject, Motion, PartAnnotation

PLAY = {"revolute": 0.045, "prismatic": 0.004}
"""What hand and drives give way before a stall is felt [rad, m]."""
AROUND_A_PART = 0.22
"""Finger opening around a part."""
TURNED_TO_OPEN = ("bottle", "pen", "pressure_cooker", "coffee_maker", "window", "door")
Pose = NDArray[np.float64]
cached_object = functools.cache(make_object)  # more objects than `make_object` keeps, over and over


def object_names(category: str) -> st.SearchStrategy[str]:
    """Ids of a few of a category's objects, seen and unseen: few, because some take long to make."""
    seen = CATEGORIES[category].seen
    numbers = [*range(0, seen, max(1, seen // 4)), *range(seen, seen + 3)]
    return st.sampled_from([object_id(category, number) for number in numbers])


def placed_parts(obj: ArticulatedObject, seed: int = 0) -> dict[str, PartAnnotation]:
    """Annotations in the base frame of a robot that the object stands before, somewhere; held from any good side."""
    rng = np.random.default_rng(seed)
    yaw = np.pi + rng.uniform(-0.3, 0.3)
    frame = transform((rng.uniform(0.5, 0.8), rng.uniform(-0.2, 0.2), 0.3), rotation_about((0, 0, 1), yaw))
    return {part.name: part.in_frame(frame).rolled(float(rng.choice(part.rolls))) for part in obj.parts}


@dataclass(frozen=True)
class Move:
    """A key frame that moved, or tried to move, a joint: by its sign, as felt before it, and from where to where."""

    joint: str
    sign: int
    start: float
    end: float
    stalled: bool


class KinematicWorld:
    """One episode.

    Args:
        name: object id.
        hidden: hidden values; those left out are drawn with ``draw``.
        layout: seed of where the object stands.
        torn: this many pulls at the joint that opens end with an empty hand that has reached its goal.
        torn_from: they do so where this joint stands here [rad or m] or farther, half way to where it was pulled.
        stride: how far the joint that opens comes at most in one key frame [rad or m]; a stiff one stalls on its way.
        grip: how far one grip takes the joint that opens [rad or m]; then the fingers slide along the part.
        preset: of the mechanism. ``hard`` is the default here: nothing about it is the same in all episodes.
    """

    def __init__(
        self,
        name: str,
        hidden: Mapping[str, Any] | None = None,
        *,
        draw: int = 0,
        layout: int = 0,
        torn: int = 0,
        torn_from: float = 0.0,
        stride: float = np.inf,
        grip: float = np.inf,
        preset: str = "hard",
    ) -> None:
        self.obj = cached_object(name)
        self.parts = placed_parts(self.obj, layout)
        self.preset, self.mechanism = preset, make_mechanism(self.obj, preset)
        self.state = self.mechanism.draw(np.random.default_rng(draw), hidden)
        self.hidden = self.mechanism.hidden(self.state)
        self.joints = dict.fromkeys(self.mechanism.joints, 0.0)
        self.final, self.key = self.mechanism.joints
        self.held: PartAnnotation | None = None
        self.grip, self.gripped_at = grip, 0.0
        self.torn, self.torn_from, self.stride = torn, torn_from, stride
        self.feedback = Feedback(transform((0.4, 0.0, 0.6)), 1.0)
        self.moves: list[Move | None] = []
        self.successes: list[bool] = []
        self._limits()

    def advance(self, **positions: float) -> None:
        """Puts joints where they come to in the course of an episode: the key first, then what it frees."""
        for joint in sorted(positions, key=self.mechanism.joints.index, reverse=True):
            lower, upper = self._limits()[joint]
            assert lower <= positions[joint] <= upper, f"{joint} cannot get there"
            self.joints[joint] = positions[joint]
        self._limits()

    def _limits(self) -> dict[str, tuple[float, float]]:
        self.state, limits = self.mechanism.step(self.state, self.joints)
        return limits

    def step(self, goal: Goal) -> Feedback:
        """Runs one key frame."""
        self.moves.append(None)
        was_closed, button = self.feedback.gripper < 0.5, self._button_before(goal.tcp_in_base)
        if goal.gripper > 0.5:
            self.held = None
        self._spring_back()
        if self.held is not None:
            self.feedback = self._move(self.held, goal, AROUND_A_PART)
        elif goal.gripper < 0.5 and was_closed and button is not None:
            self.feedback = self._move(button, goal, 0.0)
        else:
            closes = goal.gripper < 0.5 and not was_closed
            self.held = self._within_reach(goal.tcp_in_base) if closes else None
            self.gripped_at = self.joints[self.final]
            opening = AROUND_A_PART if self.held else goal.gripper
            self.feedback = Feedback(goal.tcp_in_base.copy(), opening, Outcome.REACHED)
        self.successes.append(self.mechanism.succeeded(self.joints))
        return self.feedback

    def _button_before(self, goal: Pose) -> PartAnnotation | None:
        """The part, if any, that a closed hand on its way to ``goal`` pushes: it slides, and the hand is before it."""
        for part in self.parts.values():
            motion = part.motions[-1]
            depth = motion.followed(part.grasp, goal)
            beside = goal[:3, 3] - part.grasp[:3, 3] - depth * motion.axis
            if motion.kind == "prismatic" and depth > 1e-3 and np.linalg.norm(beside) < 0.01:
                return part
        return None

    def _spring_back(self) -> None:
        """Buttons come back as soon as nothing pushes them, levers when they are let go; lids fall shut."""
        for joint in self.joints:
            if self.held is None and (self.obj.joint(joint).stiffness > 0 or joint == "lift"):
                self.joints[joint] = float(np.clip(0.0, *self._limits()[joint]))  # a lock may keep a lever
            elif self.held is None and joint == "drop" and self.joints[joint] > 1e-3:
                self.joints[joint] = self._limits()[joint][1]

    def _within_reach(self, tcp: Pose) -> PartAnnotation | None:
        for part in self.parts.values():
            there = part.moved(self.joints)
            if np.linalg.norm(there[:3, 3] - tcp[:3, 3]) < 0.01 and angle_between(there[:3, :3], tcp[:3, :3]) < 0.1:
                return part
        return None

    def _move(self, part: PartAnnotation, goal: Goal, opening: float) -> Feedback:
        """The hand takes along, or pushes, the joint that its way to the goal fits best."""
        motion = meant(_present(part, self.joints), self.feedback.tcp_in_base, goal.tcp_in_base)
        joint, start = motion.joint, self.joints[motion.joint]
        sign = int(np.sign(motion.followed(self.feedback.tcp_in_base, goal.tcp_in_base)))
        if joint == self.final and self.torn and start >= self.torn_from:
            self.torn -= 1
            self.held = None
            if self.torn_from > 0:
                there = start + motion.followed(part.moved(self.joints), goal.tcp_in_base) / 2
                self.joints[joint] = float(np.clip(there, *self._limits()[joint]))
            return Feedback(goal.tcp_in_base.copy(), 0.0, Outcome.REACHED)
        wanted = start + motion.followed(part.moved(self.joints), goal.tcp_in_base)
        reach = self.stride if joint == self.final else np.inf
        near = np.clip(wanted, start - reach, start + reach)
        if joint == self.final:
            near = min(near, self.gripped_at + self.grip)
        self.joints[joint] = float(np.clip(near, *self._limits()[joint]))
        self._limits()
        beyond, play = wanted - self.joints[joint], PLAY[motion.kind]
        felt = part.moved({**self.joints, joint: self.joints[joint] + float(np.clip(beyond, -play, play))})
        stalled = abs(beyond) > play
        self.moves[-1] = Move(joint, sign, start, self.joints[joint], stalled)
        return Feedback(felt, opening, Outcome.STALLED if stalled else Outcome.REACHED)


def _present(part: PartAnnotation, joints: Mapping[str, float]) -> list[Motion]:
    """A part's motions with their axes where the joints before them have taken them."""
    frame, motions = np.eye(4), []
    for motion in part.motions:
        motions.append(motion.in_frame(frame))
        frame = frame @ motion.applied(np.eye(4), joints[motion.joint])
    return motions


def meant(motions: list[Motion], start: Pose, goal: Pose) -> Motion:
    """The motion that leads from ``start`` nearest to ``goal``; a radian counts as much as 10 cm."""

    if len(motions) == 1:
        return motions[0]

    def missed(motion: Motion) -> float:
        there = motion.applied(start, motion.followed(start, goal))
        away = float(np.linalg.norm(there[:3, 3] - goal[:3, 3]))
        return away + 0.1 * angle_between(there[:3, :3], goal[:3, :3])

    return min(motions, key=missed)


@dataclass
class Episode:
    """What happened: goals, the feedback after each, and the world in the end."""

    goals: list[Goal]
    felt: list[Feedback]
    world: KinematicWorld

    @property
    def phases(self) -> list[Phase]:
        return [goal.phase for goal in self.goals]

    @property
    def opened(self) -> float:
        """Where the joint that opens stands in the end [rad or m]."""
        return self.world.joints[self.world.final]

    @property
    def key_frames(self) -> float:
        """Until success; infinity without."""
        return self.world.successes.index(True) + 1 if any(self.world.successes) else np.inf

    @property
    def moves(self) -> list[Move]:
        """Those key frames that moved, or tried to move, a joint, up to success."""
        until = None if self.key_frames == np.inf else int(self.key_frames)
        return [move for move in self.world.moves[:until] if move is not None]

    def failed_pulls(self) -> int:
        pairs = zip(self.goals, self.felt, strict=True)
        return sum(felt.failed or felt.gripper < 0.05 for goal, felt in pairs if goal.phase is Phase.TRY)

    def turns(self) -> list[tuple[int, bool]]:
        """Each move of the key joint: (sign relative to the hand before it, whether it stalled)."""
        return [(move.sign, move.stalled) for move in self.moves if move.joint == self.world.key]


def run(world: KinematicWorld, frames: KeyFrames, *, until: str = "", at_most: int = 80) -> Episode:
    """Plays an expert against a world until it has nothing more to do, or has tried a joint named ``until``."""
    goals, felt = [next(frames)], []
    for _ in range(at_most):
        felt.append(world.step(goals[-1]))
        if until and (move := world.moves[-1]) is not None and until in (move.joint, "any"):
            return Episode(goals, felt, world)
        try:
            goals.append(frames.send(felt[-1]))
        except StopIteration:
            return Episode(goals, felt, world)
    raise AssertionError("the expert does not end")


def adaptive(world: KinematicWorld, seed: int = 0, trials: int = 1, preset: str = "paper", **known: Any) -> KeyFrames:
    rng, category = np.random.default_rng(seed), world.obj.category
    options: dict[str, Any] = {"trials": trials, "strategy": preset, "mechanism_rules": world.preset, **known}
    return make_expert(category, "adaptive", world.parts, generator=rng, **options)


def static(world: KinematicWorld, seed: int = 0, **known: Any) -> KeyFrames:
    rng, category = np.random.default_rng(seed), world.obj.category
    options: dict[str, Any] = {"hidden": world.hidden, "mechanism_rules": world.preset, **known}
    return make_expert(category, "static", world.parts, generator=rng, **options)


def as_bytes(goals: list[Goal]) -> list[tuple[bytes, float, Phase]]:
    return [(goal.tcp_in_base.tobytes(), goal.gripper, goal.phase) for goal in goals]


@dataclass
class Watched:
    """A world in which another agent acts, and the expert only observes."""

    world: KinematicWorld
    belief: Belief = field(default_factory=Belief)

    def step(self, goal: Goal) -> Feedback:
        before = dict(self.world.joints)
        feedback = self.world.step(goal)
        move = self.world.moves[-1]
        if move is not None:
            covered = abs(self.world.joints[move.joint] - before[move.joint])
            failed = move.stalled and covered < (
                0.003 if self.world.obj.joint(move.joint).kind == "prismatic" else 0.05
            )
            labels = KeyFrameLabels(self.world.mechanism.joints.index(move.joint), failed, 0.0, 0, float(move.sign))
            joints, after = self.world.mechanism.joints, dict(self.world.joints)
            self.belief = self.belief.after(labels, joints, before, after, stalled=feedback.failed)
        return feedback

    def taken_over(self, seed: int, **known: Any) -> Any:
        positions = dict(self.world.joints)
        return adaptive(
            self.world, seed, positions=positions, feedback=self.world.feedback, belief=self.belief, **known
        )

    def asked_anew(self, seed: int, *, at_most: int, **known: Any) -> None:
        """Runs an expert made anew at each key frame, as corrections do, until it has opened."""
        for number in range(at_most + 1):
            if any(self.world.successes):
                return
            goal = next(self.taken_over(seed + number, **known), None)
            assert goal is not None
            here = self.world.feedback
            stays = np.allclose(goal.tcp_in_base, here.tcp_in_base, atol=1e-6)
            assert not (stays and goal.gripper == 1.0 and here.gripper > 0.9), "opens a hand that is open"
            self.step(goal)
        raise AssertionError("never opened")
