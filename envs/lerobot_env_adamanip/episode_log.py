"""What an episode was: watched from outside, for logs and reports. Nothing here reaches an observation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.keyframes import Feedback, Outcome
from lerobot_adamanip.objects import Motion, PartAnnotation
from lerobot_adamanip.rotations import angle_between

NEAR_PART = 0.06
"""A closed hand within this distance of a part's grasp holds it [m]."""
TRIED_DISTANCE, TRIED_ANGLE = 0.008, 0.1
"""A goal at least this far away was a try, not just a grip that closed [m, rad]."""
AJAR = {"revolute": 0.05, "prismatic": 0.004}
"""A joint nearer to rest than this did not give [rad, m]."""
TURNED = {"revolute": float(np.deg2rad(8.0)), "prismatic": 0.004}
"""A key moved by more than this was tried [rad, m]."""


class EpisodeMonitor:
    """Counts key frames, tries and what was held first.

    Args:
        sim: the running task.
        seed: of the episode.
    """

    def __init__(self, sim: Any, seed: int) -> None:
        self._sim, self.seed = sim, seed
        self.hidden = sim.hidden_state()
        self.key_frames = 0
        self.success = False
        self.first_part: str | None = None
        self.blocked_pulls = self.wrong_turns = 0
        self.key_moved = False
        self._final, *self._keys = sim.mechanism.joints
        self._kinds = {name: sim.obj.joint(name).kind for name in sim.mechanism.joints}
        self._tcp: NDArray[np.float64] = sim.feedback.tcp_in_base

    def after_key_frame(self, feedback: Feedback) -> bool:
        """Takes note of a key frame's end. Returns whether the episode has succeeded; once true, it stays so."""
        self.key_frames += 1
        joints = self._sim.joint_positions()
        goal, grip = self._sim.goal
        part = self._held(joints, feedback)
        if grip < 0.5 and part is not None:
            self.first_part = self.first_part or part.name
            if feedback.outcome is Outcome.STALLED and self._was_try(goal):
                self._count(meant(part, self._tcp, goal), joints)
        self.key_moved |= any(abs(joints[name]) > TURNED[self._kinds[name]] for name in self._keys)
        self.success |= self._sim.succeeded()
        self._tcp = feedback.tcp_in_base
        return self.success

    def _held(self, joints: dict[str, float], feedback: Feedback) -> PartAnnotation | None:
        """Returns the part the tool is at, where the part is now."""
        tool = feedback.tcp_in_base[:3, 3]
        parts = self._sim.placement.annotations.values()
        near = [(float(np.linalg.norm(tool - part.moved(joints)[:3, 3])), part.name) for part in parts]
        distance, name = min(near)
        return self._sim.placement.annotations[name] if distance < NEAR_PART else None

    def _was_try(self, goal: NDArray[np.float64]) -> bool:
        far = np.linalg.norm(goal[:3, 3] - self._tcp[:3, 3]) > TRIED_DISTANCE
        return bool(far or angle_between(goal[:3, :3], self._tcp[:3, :3]) > TRIED_ANGLE)

    def _count(self, joint: str, joints: dict[str, float]) -> None:
        if joint == self._final:
            self.blocked_pulls += abs(joints[joint]) < AJAR[self._kinds[joint]]
        else:
            self.wrong_turns += abs(joints[joint]) < TURNED[self._kinds[joint]]

    def record(self) -> dict[str, Any]:
        """Returns the record, JSON-able.

        Keys: ``seed``, ``object_id``, ``category``, ``hidden_state``, ``success``, ``key_frames``, ``first_part`` (what
        the hand closed at first, or None), ``blocked_pulls`` (tries at the joint that opens which ended in a stall,
        with it shut), ``wrong_turns`` (tries at the key joint that ended in a stall, with it at rest), ``key_moved``,
        and ``joints`` (name -> last position [rad or m]).
        """
        return {
            "seed": self.seed,
            "object_id": self._sim.obj.object_id,
            "category": self._sim.category,
            "hidden_state": self.hidden,
            "success": self.success,
            "key_frames": self.key_frames,
            "first_part": self.first_part,
            "blocked_pulls": int(self.blocked_pulls),
            "wrong_turns": int(self.wrong_turns),
            "key_moved": self.key_moved,
            "joints": self._sim.joint_positions(),
        }


def meant(part: PartAnnotation, start: NDArray[np.float64], goal: NDArray[np.float64]) -> str:
    """Returns the joint of a held part that a motion from ``start`` to ``goal`` (4, 4) was meant to move."""

    def missed(motion: Motion) -> float:
        there = motion.applied(start, motion.followed(start, goal))
        return float(np.linalg.norm(there[:3, 3] - goal[:3, 3])) + 0.1 * angle_between(there[:3, :3], goal[:3, :3])

    return min(part.motions, key=missed).joint
