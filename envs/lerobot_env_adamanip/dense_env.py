"""Environment for LeRobot at control rate: one step is 1/fps seconds."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.control import DENSE, EE_DELTA, EE_POSE
from lerobot_adamanip.contract.dense_codec import delta_action, pose_of_delta
from lerobot_adamanip.contract.keyframes import MotionLimits
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim.arm_driver import TICKS_PER_SECOND


class DenseEnv(KeyframeEnv):
    """AdaManip environment at control rate: same scenes, hidden states, tries, limits and log as `KeyframeEnv`.

    Action: see `ACTION_NAMES`: ``ee_delta`` (7,), ``ee_pose`` (10,) or ``joint`` (8,). The arm follows it for 1/fps
        seconds, within the limits of speed and acceleration of a key frame.
    Observation: ``agent_pos``, see `STATES`: ``pose`` (8,) or ``full`` (24,); ``pixels``, camera -> (H, W, 3);
        ``point_cloud`` (N, 3) [m] and ``effort`` (7,) [N m] if they are requested.
    Info, reward and ends of an episode: as in `KeyframeEnv`; ``max_steps`` is the limit of its length.

    Implements `lerobot_adamanip.episode.dense.DenseEnvironment`.

    Args:
        category, options, render_mode, values: see `KeyframeEnv`.
    """

    CONTROL = DENSE

    def __init__(self, category: str | None = None, **values: Any) -> None:
        super().__init__(category, **({} if "options" in values else {"control": DENSE}) | values)
        self._ticks = TICKS_PER_SECOND // self.options.fps

    def motion(self, action: NDArray[np.float32]) -> Generator[None]:
        """Runs one step; yields after each control tick. Raises `ConfigurationError` for a malformed action."""
        episode, values = self.episode, np.asarray(action, np.float64)
        driver, kind = episode.task.driver, self.options.action
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            raise ConfigurationError(
                "Malformed action.",
                got=f"shape {values.shape}" if values.shape != self.action_space.shape else f"{values.tolist()}",
                allowed=f"{self.action_space.shape} finite numbers: {kind}",
                hint="--env.action=ee_delta|ee_pose|joint; env.action_space",
            )
        if kind == EE_DELTA:
            driver.follow_target(pose_of_delta(values, driver.measured().tcp_in_base))
        elif kind == EE_POSE:
            driver.follow_target(values.astype(np.float32))
        else:
            driver.follow_joints(values[:-1], float(values[-1]))
        for _ in range(self._ticks):
            driver.stream_tick()
            yield
        self._image = None
        episode.after_step()

    # For experts, see `lerobot_adamanip.episode.dense.DenseEnvironment` ---------------------------------------------

    def action_toward(self, target: NDArray[np.float64], gripper: float) -> NDArray[np.float32]:
        """Returns the action that moves the tool to a pose (4, 4), robot base frame, and the gripper."""
        driver = self.episode.task.driver
        if self.options.action == EE_DELTA:
            return delta_action(target, gripper, driver.measured().tcp_in_base)
        if self.options.action == EE_POSE:
            return pose_vector(target, gripper)
        return np.append(driver.posture(target), gripper).astype(np.float32)

    @property
    def motion_limits(self) -> MotionLimits:
        """Limits of the arm's motion in this category."""
        return self.episode.task.definition.motion

    @property
    def is_blocked(self) -> bool:
        """Whether the tool presses against an obstacle in front of its target."""
        return self.episode.task.driver.stalled

    @property
    def is_unreachable(self) -> bool:
        """Whether the arm cannot move any closer to its target."""
        return self.episode.task.driver.unreachable

    @property
    def is_at_rest(self) -> bool:
        """Whether the arm's joints stand still."""
        return self.episode.task.driver.is_at_rest
