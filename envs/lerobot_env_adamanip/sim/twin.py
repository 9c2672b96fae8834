"""Backend with a simulated arm in one of this project's scenes. It has the protocol of a real arm."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT
from lerobot_adamanip.contract.control import KEYFRAME
from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.hardware.arm import RESET, ArmMode, ArmReading, ArmTarget, Served
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.util.errors import RobotError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.twin.process import SUCCESS_BOX, TwinOptions

TICK = 0.02
"""One control tick of the simulation [s]."""
MOST_TICKS = 10
"""Maximum late ticks to catch up at once. Further time is lost."""
MOVING = 0.01
"""Maximum joint speed of an arm at rest [rad/s]."""


class SapienBackend:
    """An `ArmBackend` on the arm of a `KeyframeEnv`. Key frames are `KeyframeEnv.motion`, one tick at a time.

    Args:
        options: see `TwinOptions`.
        boxes: mailboxes for frames and success. Missing ones are not filled.
    """

    period = TICK

    def __init__(self, options: TwinOptions, boxes: Mapping[str, Mailbox] | None = None) -> None:
        self._options, self._boxes = options, boxes or {}
        self.env = KeyframeEnv(options=options.environment.changed(control=KEYFRAME, observe_images=False))
        self._motion: Generator[None] | None = None
        self._outcome: Outcome | None = None
        self._time, self._ticked = 0.0, time.perf_counter()
        self._success, self._frames, self._seed = False, 0, options.seed
        self._connected = self._streaming = False
        self._ready: dict[str, bool] = {}

    # Connection ------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Starts the simulator with the scene of the first seed. Raises the errors of `KeyframeEnv.reset`."""
        self._connected = True
        self.reset({"seed": self._options.seed})

    def close(self) -> None:
        """Ends the simulator. Idempotent."""
        if self._connected:
            self._connected = False
            self._abort()
            self.env.close()

    # Time ------------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Advances one tick. In real time, advances all ticks since the last call."""
        now = time.perf_counter()
        due = 1 if self._options.lockstep else round((now - self._ticked) / TICK)
        for _ in range(max(1, min(due, MOST_TICKS))):
            self._tick()
        self._ticked = now if due > MOST_TICKS else self._ticked + max(1, due) * TICK

    def _tick(self) -> None:
        episode = self.env.episode
        simulation, driver = episode.task.simulation, episode.task.driver
        before, is_done = simulation.ticks, False
        if self._motion is not None:
            try:
                next(self._motion)
            except StopIteration:
                self._motion, self._outcome, is_done = None, driver.feedback.outcome, episode.success
        else:
            driver.stream_tick()
            is_done = simulation.succeeded()
        if is_done and not self._success:
            self._publish_success(True)
        # A motion ends in the slice after its last tick. That slice has no tick, but the arm's clock must advance.
        self._time += max(1, simulation.ticks - before) * TICK

    def read(self) -> ArmReading:
        """Returns the state after the latest tick. The stamp is this machine's time."""
        task = self.env.episode.task
        measured, joints = task.driver.measured(), task.simulation.arm_state()
        effort = task.driver.effort if task.errors is None else task.errors.effort(task.driver.effort)
        moves = self._motion is not None or bool(np.abs(joints.qvel).max() > MOVING)
        return ArmReading(
            stamp=time.perf_counter() if self._options.lockstep else min(self._ticked, time.perf_counter()),
            robot_time=self._time,
            tcp_in_base=measured.tcp_in_base,
            gripper=float(np.clip(measured.gripper, 0.0, 1.0)),
            qpos=joints.qpos,
            qvel=joints.qvel,
            effort=effort.copy(),
            mode=ArmMode.MOVING if moves else ArmMode.IDLE,
            outcome=None if self._motion is not None else self._outcome,
        )

    # Motion ----------------------------------------------------------------------------------------------------------

    def stream(self, target: ArmTarget) -> None:
        """Replaces the target of the stream. Aborts a running key frame."""
        self._abort()
        self._outcome, self._streaming = None, True
        self.env.episode.task.driver.follow_target(target.pose)

    def begin_keyframe(self, target: ArmTarget) -> None:
        """Starts a key frame at the arm's current pose."""
        self._abort()
        if self._streaming:
            self.env.episode.task.driver.end_stream()
        self._outcome, self._streaming = None, False
        self._motion = self.env.motion(target.pose)

    def stop(self) -> None:
        """Decelerates. The arm then holds its position."""
        self._abort()
        self._streaming = True
        self.env.episode.task.driver.hold()

    def recover(self) -> None:
        """Does nothing: a simulated arm has no faults."""

    def _abort(self) -> None:
        motion, self._motion = self._motion, None
        if motion is not None:
            motion.close()
            self.env.episode.task.driver.break_off()

    # Requests --------------------------------------------------------------------------------------------------------

    def reset(self, values: dict[str, Any]) -> dict[str, Any]:
        """Resets to the scene of ``seed`` and returns `describe`. Raises ValueError for an invalid seed."""
        seed = values.get("seed")
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**31:
            raise ValueError(f"seed is {seed!r}, not a whole number, 0 ... 2147483647")
        self._abort()
        self.env.reset(seed=seed)
        self._outcome, self._streaming, self._seed = None, False, seed
        self._publish_success(False)
        for name, with_depth in self._ready.items():  # pictures were requested, and will be again
            self._picture(name, with_depth)
        self._ticked = time.perf_counter()
        return self.describe()

    def describe(self) -> dict[str, Any]:
        """Returns the episode's public description, without hidden values."""
        env = self.env
        return {
            "seed": self._seed,
            "category": env.category,
            "object_id": env.episode.task.simulation.obj.object_id,
            "task": env.task_description,
            "mechanism_rules": env.options.mechanism_rules,
            "annotations": dict(env.annotations),
            "camera": env.camera_parameters(),
        }

    def look(self, values: dict[str, Any]) -> dict[str, Any]:
        """Puts a picture of ``camera``, with ``depth`` or without, into its mailbox and returns its number."""
        name, with_depth = values.get("camera"), values.get("depth")
        if name not in CAMERAS or name not in self._boxes or not isinstance(with_depth, bool):
            raise RobotError(f"The twin was started without a camera {name!r:.40}.")
        if with_depth and name != FRONT:
            raise RobotError(f"The twin's camera {name} has no depth.", got="use_depth=true", allowed=f"only {FRONT}")
        if name not in self._ready:  # a scene's first picture takes ten times as long and would count as stale
            self._picture(name, with_depth)
            self._ready[name] = with_depth
        stamp = time.perf_counter()
        color, depth = self._picture(name, with_depth)
        self._frames += 1
        self._boxes[name].write(Frame(stamp, stamp, color, depth, self._frames))
        return {"number": self._frames}

    def _picture(self, name: str, with_depth: bool) -> tuple[Any, Any]:
        cameras = self.env.episode.task.cameras
        if with_depth:
            return cameras.color_and_depth(self._options.image_source)
        is_rendered = self._options.image_source == "render"
        return cameras.image(name) if is_rendered else cameras.raycast_image(name), None

    def episode(self, _: dict[str, Any]) -> dict[str, Any]:
        """Returns the episode's state with hidden values. For logs only, never for features."""
        ticks = self.env.episode.task.simulation.ticks
        return {
            **self.env.episode_record(),
            "success": self._success,
            "given_seed": self._seed,
            "seconds": round(ticks * TICK, 6),
        }

    def _publish_success(self, done: bool) -> None:
        self._success = done
        if SUCCESS_BOX in self._boxes:
            self._boxes[SUCCESS_BOX].write(self._success)


def serve_twin(options: TwinOptions, boxes: Mapping[str, Mailbox]) -> Served:
    """Returns the backend of the simulated arm, see `BackendFactory`."""
    backend = SapienBackend(options, boxes)
    handlers = {RESET: backend.reset, "look": backend.look, "episode": backend.episode}
    return Served(backend, handlers, backend.describe)
