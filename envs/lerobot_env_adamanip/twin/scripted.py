"""Scripted teleoperator: plays the adaptive expert from the twin's annotations and the arm's readings."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrames
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.robot_registry import RobotSession
from lerobot_adamanip.hardware.target_geometry import Target
from lerobot_adamanip.hardware.teleoperators.tcp_teleop import TcpTeleop
from lerobot_adamanip.lerobot_patches.episode_signals import end_episode
from lerobot_adamanip.util.errors import RobotError
from lerobot_env_adamanip.twin.config_devices import AdamanipScriptedConfig
from lerobot_env_adamanip.twin.played_motion import PlayedMotion


class AdamanipScripted(TcpTeleop):
    """Streams an expert's key frames to the robot. It uses only readings to judge them, no hidden values."""

    config_class = AdamanipScriptedConfig
    name = "adamanip_scripted"
    config: AdamanipScriptedConfig

    def __init__(self, config: AdamanipScriptedConfig, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(config, clock)
        self._frames: KeyFrames | None = None
        self._motion: PlayedMotion | None = None
        self._idle = 0.0
        self.key_frames = 0
        """Number of key frames played in this episode."""

    def _begin(self, session: RobotSession, *, new_episode: bool) -> None:
        if new_episode:
            self._frames = self._motion = None
            self._idle, self.key_frames = 0.0, 0

    def _advance(self, session: RobotSession, reading: ArmReading, dt: float) -> Target:
        assert self._filter is not None
        sent = self._filter.last
        assert sent is not None
        if self._frames is None:
            self._frames = self._expert(session)
            self._motion = self._next(reading, sent, None)
        if self._motion is None:
            self._stay(dt)
            return self._to(sent, reading, dt)
        target = self._motion.step(reading, sent, dt)
        if self._motion.outcome is not None:
            self._motion = self._next(reading, sent, self._motion.feedback(reading))
        return self._to(target, reading, dt)

    def _expert(self, session: RobotSession) -> KeyFrames:
        details = session.details
        try:
            return make_expert(
                details["category"],
                "adaptive",
                details["annotations"],
                generator=np.random.default_rng([self.config.seed, int(details["seed"])]),
                trials=self.config.trials,
                mechanism_rules=details["mechanism_rules"],
            )
        except KeyError as missing:
            raise RobotError(
                "The scripted teleoperator has no annotations of the scene.",
                got=f"a robot without {missing}",
                allowed="the twin",
                hint="--robot.type=adamanip_franka_sim",
            ) from None

    def _next(self, reading: ArmReading, sent: Target, felt: Feedback | None) -> PlayedMotion | None:
        assert self._frames is not None
        try:
            goal: Goal = next(self._frames) if felt is None else self._frames.send(felt)
        except StopIteration:
            return None
        self.key_frames += 1
        return PlayedMotion(
            start=reading.tcp_in_base,
            goal=goal.tcp_in_base,
            held=float(sent[GRIPPER_DIM]),
            gripper=goal.gripper,
            speed=self.config.speed,
            angular_speed=self.config.angular_speed,
            pause=self.config.pause,
        )

    def _stay(self, dt: float) -> None:
        before, self._idle = self._idle, self._idle + dt
        if before < self.config.stay <= self._idle:
            end_episode()
