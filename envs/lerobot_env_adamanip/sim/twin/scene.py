"""Key-frame environment whose arm can also follow a stream, one control tick at a time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim.robot import AdaManipPanda
from lerobot_env_adamanip.sim.tasks import AdaManipTask
from lerobot_env_adamanip.sim.twin.camera import TwinEye
from lerobot_env_adamanip.sim.twin.stream_driver import StreamDriver


class TwinScene(KeyframeEnv):
    """`KeyframeEnv` with an arm that can also follow a stream. The scenes are the same.

    Attributes:
        after_tick: called after every control tick of a key frame; `SteppedMotion.pause` slices key frames there.
        ticks: control ticks since the latest reset.
    """

    after_tick: Callable[[], None] | None = None
    ticks = 0
    driver: StreamDriver
    """Driver of the arm in the current episode."""

    @property
    def task_simulation(self) -> AdaManipTask:
        """Running task."""
        return self._running()

    @property
    def episode_success(self) -> bool:
        """Whether the task was done at the end of a key frame of this episode."""
        return self._episode().success

    def eye(self, size: int, source: str) -> TwinEye:
        """Returns the episode's front camera, see `TwinEye`."""
        task = self._running()
        robot, urdf = task.agent.robot._objs[0], Path(task.agent.urdf_path)
        return TwinEye(task.views, robot, urdf, size=size, source=source, render_backend=self.options.render_backend)

    def _placed(self, sim: AdaManipTask, seed: int, chosen: dict[str, Any]) -> int:
        drawn = super()._placed(sim, seed, chosen)
        self.ticks = 0

        def tick(target: NDArray[np.float64], velocity: NDArray[np.float64], finger: float) -> None:
            sim._tick(target, velocity, finger)
            self.ticks += 1
            if self.after_tick is not None:
                self.after_tick()

        # The task has created its own driver for this episode but has not moved it. Ours starts in the same state and
        # executes key frames with the same code.
        sim._arm = self.driver = StreamDriver(
            sim._kinematics,
            sim.arm_state,
            tick,
            control_dt=sim.control_timestep,
            stiffness=np.asarray(AdaManipPanda.arm_stiffness),
            limits=sim.definition.motion,
        )
        return drawn
