"""What an episode was: watched from outside, for logs and reports. Nothing here reaches an observation."""

from __future__ import annotations

from typing import Any

import numpy as np

from lerobot_adamanip.experts.base import Feedback, Outcome
from lerobot_adamanip.rotations import angle_between

NEAR_PART = 0.06
"""A closed hand within this distance of a part's grasp holds it [m]."""
PULLED = 0.015
"""A goal missed by more than this was a pull, not just a grip that shifted [m]."""
BLOCKED_TURN = 0.15
"""A turn missed by more than this was blocked [rad]."""
AJAR = 0.05
"""A door opened by less than this did not give [rad]."""
TURNED = np.deg2rad(8.0)
"""A knob turned by more than this was tried [rad]."""


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
        self.knob_turned = False
        self._grasps = {name: part.grasp[:3, 3] for name, part in sim.layout.annotations.items()}

    def after_key_frame(self, feedback: Feedback) -> bool:
        """Takes note of a key frame's end. Returns whether the episode has succeeded; once true, it stays so."""
        self.key_frames += 1
        joints = self._sim.joint_positions()
        goal, grip = self._sim.driver.goal
        nearest = min(self._grasps, key=lambda name: self._distance(name, feedback))
        if grip < 0.5 and self._distance(nearest, feedback) < NEAR_PART:
            self.first_part = self.first_part or nearest
            missed = np.linalg.norm(goal[:3, 3] - feedback.tcp_in_base[:3, 3]) > PULLED
            stalled = feedback.outcome is Outcome.STALLED
            if nearest == "handle" and stalled and missed and joints["door"] < AJAR:
                self.blocked_pulls += 1
            unturned = angle_between(goal[:3, :3], feedback.tcp_in_base[:3, :3]) > BLOCKED_TURN
            if nearest == "knob" and stalled and unturned and abs(joints["knob"]) < TURNED:
                self.wrong_turns += 1
        self.knob_turned |= bool(abs(joints.get("knob", 0.0)) > TURNED)
        self.success |= bool(self._sim.evaluate()["success"][0])
        return self.success

    def _distance(self, name: str, feedback: Feedback) -> float:
        return float(np.linalg.norm(feedback.tcp_in_base[:3, 3] - self._grasps[name]))

    def record(self) -> dict[str, Any]:
        """Returns the record, JSON-able.

        Keys: ``seed``, ``object_id``, ``hidden_state``, ``success``, ``key_frames``, ``first_part`` (what the hand
        closed at first, or None), ``blocked_pulls`` (pulls at the handle that ended in a stall with the door shut),
        ``wrong_turns`` (turns of the knob that ended in a stall with the knob at rest), ``knob_turned``, and
        ``door_angle`` [rad].
        """
        return {
            "seed": self.seed,
            "object_id": self._sim.obj.object_id,
            "hidden_state": self.hidden,
            "success": self.success,
            "key_frames": self.key_frames,
            "first_part": self.first_part,
            "blocked_pulls": self.blocked_pulls,
            "wrong_turns": self.wrong_turns,
            "knob_turned": self.knob_turned,
            "door_angle": self._sim.joint_positions()["door"],
        }
