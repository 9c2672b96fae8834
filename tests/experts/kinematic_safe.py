"""A safe and a hand without a simulator: joints follow the held part within the limits that the mechanism commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from lerobot_adamanip.experts import Feedback, Goal, KeyFrames, Outcome, Phase, make_expert
from lerobot_adamanip.mechanisms import SafeMechanism
from lerobot_adamanip.objects import PartAnnotation, make_object
from lerobot_adamanip.objects.safe import DOOR_UPPER, knob_range
from lerobot_adamanip.rotations import angle_between, rotation_about, transform

PLAY = 0.045
"""What hand and drives give way before a stall is felt [rad]: an expert has to tell it from motion."""
JOINT_OF = {"handle": "door", "knob": "knob"}
GRIPS = {"handle": 0.25, "knob": 0.2}
"""Finger opening around a part."""


def placed_parts(object_id: str, seed: int = 0) -> dict[str, PartAnnotation]:
    """Annotations in the base frame of a robot that the object stands before, somewhere."""
    rng = np.random.default_rng(seed)
    yaw = np.pi + rng.uniform(-0.3, 0.3)
    frame = transform((rng.uniform(0.5, 0.8), rng.uniform(-0.2, 0.2), 0.3), rotation_about((0, 0, 1), yaw))
    return {part.name: part.in_frame(frame) for part in make_object(object_id).parts}


class KinematicSafe:
    """One episode. ``torn`` pulls at the handle end with an empty hand that has reached its goal."""

    def __init__(self, object_id: str, hidden: dict[str, Any], *, layout: int = 0, torn: int = 0) -> None:
        self.parts = placed_parts(object_id, layout)
        self.mechanism = SafeMechanism(DOOR_UPPER, knob_range(make_object(object_id)))
        self.state = self.mechanism.draw(1, torch.Generator().manual_seed(0), hidden)
        self.hidden = self.mechanism.hidden(self.state, 0)
        self.joints = {"door": 0.0, "knob": 0.0}
        self.held: str | None = None
        self.torn = torn
        self.feedback = Feedback(transform((0.4, 0.0, 0.6)), 1.0)
        self._limits()

    def _limits(self) -> dict[str, tuple[float, float]]:
        reading = {name: torch.tensor([q], dtype=torch.float64) for name, q in self.joints.items()}
        self.state, command = self.mechanism.step(self.state, reading)
        return {name: (float(limit.lower), float(limit.upper)) for name, limit in command.items()}

    def step(self, goal: Goal) -> Feedback:
        """Runs one key frame."""
        if goal.gripper > 0.5 or self.held is None:
            self.held = None
            pose, opening, outcome = goal.tcp_in_base, goal.gripper, Outcome.REACHED
            if goal.gripper < 0.5:
                self.held = self._within_reach(goal.tcp_in_base)
                opening = GRIPS[self.held] if self.held else 0.0
        else:
            pose, opening, outcome = self._move_held(goal, self.held)
        self.feedback = Feedback(np.array(pose), opening, outcome)
        return self.feedback

    def _within_reach(self, tcp: np.ndarray) -> str | None:
        for name, part in self.parts.items():
            there = part.turned(self.joints[JOINT_OF[name]])
            # The knob rides on the door: where the door stands open, it is not where its annotation says.
            is_there = name == "handle" or self.joints["door"] < 0.02
            near = np.linalg.norm(there[:3, 3] - tcp[:3, 3]) < 0.01 and angle_between(there[:3, :3], tcp[:3, :3]) < 0.1
            if is_there and near:
                return name
        return None

    def _move_held(self, goal: Goal, name: str) -> tuple[np.ndarray, float, Outcome]:
        part, joint = self.parts[name], JOINT_OF[name]
        if name == "handle" and self.torn:
            self.torn -= 1
            self.held = None
            return goal.tcp_in_base, 0.0, Outcome.REACHED
        turn = Rotation.from_matrix(goal.tcp_in_base[:3, :3] @ part.grasp[:3, :3].T).as_rotvec()
        wanted = float(part.axis @ turn)
        lower, upper = self._limits()[joint]
        self.joints[joint] = min(max(wanted, lower), upper)
        self._limits()
        beyond = wanted - self.joints[joint]
        felt = part.turned(self.joints[joint] + float(np.clip(beyond, -PLAY, PLAY)))
        return felt, GRIPS[name], Outcome.STALLED if abs(beyond) > PLAY else Outcome.REACHED


@dataclass
class Episode:
    """What happened: goals, the feedback after each, and the safe in the end."""

    goals: list[Goal]
    felt: list[Feedback]
    safe: KinematicSafe

    @property
    def phases(self) -> list[Phase]:
        return [goal.phase for goal in self.goals]

    @property
    def door(self) -> float:
        return self.safe.joints["door"]

    def failed_pulls(self) -> int:
        return sum(
            f.failed or f.gripper < 0.05 for g, f in zip(self.goals, self.felt, strict=True) if g.phase is Phase.TRY
        )

    def turns(self) -> list[tuple[int, bool]]:
        """Each key frame at the knob: (sign of the turn relative to the hand before it, whether it stalled)."""
        result, part = [], self.safe.parts["knob"]
        for i, goal in enumerate(self.goals):
            if goal.phase is Phase.UNLOCK:
                relative = goal.tcp_in_base[:3, :3] @ self.felt[i - 1].tcp_in_base[:3, :3].T
                sign = int(np.sign(part.axis @ Rotation.from_matrix(relative).as_rotvec()))
                result.append((sign, self.felt[i].failed))
        return result


def run(safe: KinematicSafe, frames: KeyFrames, *, at_most: int = 80) -> Episode:
    """Plays an expert against a safe until it has nothing more to do."""
    goals, felt = [next(frames)], []
    for _ in range(at_most):
        felt.append(safe.step(goals[-1]))
        try:
            goals.append(frames.send(felt[-1]))
        except StopIteration:
            return Episode(goals, felt, safe)
    raise AssertionError("the expert does not end")


def adaptive(safe: KinematicSafe, seed: int = 0, trials: int = 1) -> KeyFrames:
    return make_expert("safe", "adaptive", safe.parts, generator=np.random.default_rng(seed), trials=trials)


def static(safe: KinematicSafe, seed: int = 0) -> KeyFrames:
    return make_expert("safe", "static", safe.parts, generator=np.random.default_rng(seed), hidden=safe.hidden)


def as_bytes(goals: list[Goal]) -> list[tuple[bytes, float, Phase, int]]:
    return [(goal.tcp_in_base.tobytes(), goal.gripper, goal.phase, goal.trial) for goal in goals]
