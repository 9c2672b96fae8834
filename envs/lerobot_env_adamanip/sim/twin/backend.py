"""Backend with a simulated arm in one of this project's scenes. It has the protocol of a real arm."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.hardware.arm import RESET, ArmMode, ArmReading, ArmTarget, Served
from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.util.errors import RobotError
from lerobot_env_adamanip.sim.twin.camera import TwinEye
from lerobot_env_adamanip.sim.twin.scene import TwinScene
from lerobot_env_adamanip.sim.twin.stepped import SteppedMotion
from lerobot_env_adamanip.twin.process import FRONT_FRAMES, SUCCESS_BOX, TwinOptions

TICK = 0.02
"""One control tick of the simulation [s]."""
MOST_TICKS = 10
"""Maximum late ticks to catch up at once. Further time is lost."""
MOVING = 0.01
"""Maximum joint speed of an arm at rest [rad/s]."""


class SapienBackend:
    """An `ArmBackend` on the arm of a `TwinScene`. Key frames are `KeyframeDriver.execute`, in slices of a tick.

    Args:
        options: see `TwinOptions`.
        boxes: mailboxes for frames and success. Missing ones are not filled.
    """

    period = TICK

    def __init__(self, options: TwinOptions, boxes: Mapping[str, Mailbox] | None = None) -> None:
        self._options, self._boxes = options, boxes or {}
        self._scene = TwinScene(options=options.environment.changed(observe_images=False))
        self._eye: TwinEye | None = None
        self._motion: SteppedMotion | None = None
        self._outcome: Outcome | None = None
        self._time, self._ticked = 0.0, time.perf_counter()
        self._success, self._frames, self._seed = False, 0, options.seed
        self._connected = self._streaming = False

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
            self._scene.close()

    # Time ------------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Advances one tick. In real time, advances all ticks since the last call."""
        now = time.perf_counter()
        due = 1 if self._options.lockstep else round((now - self._ticked) / TICK)
        for _ in range(max(1, min(due, MOST_TICKS))):
            self._tick()
        self._ticked = now if due > MOST_TICKS else self._ticked + max(1, due) * TICK

    def _tick(self) -> None:
        scene = self._scene
        before, done = scene.ticks, False
        if self._motion is not None:
            if self._motion.step():
                self._motion, self._outcome = None, scene.feedback.outcome
                done = scene.episode_success
        else:
            scene.driver.stream_tick()
            done = scene.task_simulation.succeeded()
        if done and not self._success:
            self._publish_success(True)
        # A motion ends in the slice after its last tick. That slice has no tick, but the arm's clock must advance.
        self._time += max(1, scene.ticks - before) * TICK

    def read(self) -> ArmReading:
        """Returns the state after the latest tick. The stamp is this machine's time."""
        scene = self._scene
        felt, joints = scene.driver.measured(), scene.task_simulation.arm_state()
        moves = self._motion is not None or bool(np.abs(joints.qvel).max() > MOVING)
        return ArmReading(
            stamp=time.perf_counter() if self._options.lockstep else min(self._ticked, time.perf_counter()),
            robot_time=self._time,
            tcp_in_base=felt.tcp_in_base,
            gripper=float(np.clip(felt.gripper, 0.0, 1.0)),
            qpos=joints.qpos,
            qvel=joints.qvel,
            effort=scene.driver.effort.copy(),
            mode=ArmMode.MOVING if moves else ArmMode.IDLE,
            outcome=None if self._motion is not None else self._outcome,
        )

    # Motion ----------------------------------------------------------------------------------------------------------

    def stream(self, target: ArmTarget) -> None:
        """Replaces the target of the stream. Aborts a running key frame."""
        self._abort()
        self._outcome, self._streaming = None, True
        self._scene.driver.follow_target(target.pose)

    def begin_keyframe(self, target: ArmTarget) -> None:
        """Starts a key frame at the arm's current pose."""
        self._abort()
        if self._streaming:
            self._scene.driver.end_stream()
        self._outcome, self._streaming = None, False
        pose = target.pose
        self._motion = SteppedMotion(lambda: self._scene.drive(pose))
        self._scene.after_tick = self._motion.pause

    def stop(self) -> None:
        """Decelerates. The arm then holds its position."""
        self._abort()
        self._streaming = True
        self._scene.driver.hold()

    def recover(self) -> None:
        """Does nothing: a simulated arm has no faults."""

    def _abort(self) -> None:
        motion, self._motion, self._scene.after_tick = self._motion, None, None
        if motion is not None:
            motion.abort()
            self._scene.driver.break_off()

    # Requests --------------------------------------------------------------------------------------------------------

    def reset(self, values: dict[str, Any]) -> dict[str, Any]:
        """Resets to the scene of ``seed`` and returns `describe`. Raises ValueError for an invalid seed."""
        seed = values.get("seed")
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**31:
            raise ValueError(f"seed is {seed!r}, not a whole number, 0 ... 2147483647")
        self._abort()
        self._scene.reset(seed=seed)
        self._eye, self._outcome, self._streaming = None, None, False
        self._seed = seed
        self._publish_success(False)
        if self._frames:  # pictures were requested, and will be again
            self._camera().get_ready()
        self._ticked = time.perf_counter()
        return self.describe()

    def describe(self) -> dict[str, Any]:
        """Returns the episode's public description, without hidden values."""
        scene = self._scene
        return {
            "seed": self._seed,
            "category": scene.category,
            "object_id": scene.task_simulation.obj.object_id,
            "task": scene.task_description,
            "mechanism_rules": scene.options.mechanism_rules,
            "annotations": dict(scene.annotations),
            "camera": self._camera().parameters(),
        }

    def look(self, _: dict[str, Any]) -> dict[str, Any]:
        """Puts a picture into the mailbox of frames and returns its number."""
        if FRONT_FRAMES not in self._boxes:
            raise RobotError("The twin was started without a camera.")
        camera = self._camera()
        camera.get_ready()  # the slow first picture of a scene would count as stale
        taken = time.perf_counter()
        color, depth = camera.take()
        self._frames += 1
        self._boxes[FRONT_FRAMES].write(Frame(taken, taken, color, depth, self._frames))
        return {"number": self._frames}

    def _camera(self) -> TwinEye:
        if self._eye is None:
            self._eye = self._scene.eye(self._options.image_size, self._options.depth_source)
        return self._eye

    def episode(self, _: dict[str, Any]) -> dict[str, Any]:
        """Returns the episode's state with hidden values. For logs only, never for features."""
        scene = self._scene
        return {
            **scene.episode_record(),
            "success": self._success,
            "given_seed": self._seed,
            "seconds": round(scene.ticks * TICK, 6),
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
