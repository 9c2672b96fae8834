"""What every AdaManip task shares: one object on a plinth before a Panda, one camera, one hidden mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import sapien_utils
from mani_skill.utils.building.ground import build_ground
from mani_skill.utils.structs.types import SceneConfig, SimConfig
from numpy.typing import NDArray

from lerobot_adamanip.catalog import get_object, select_objects
from lerobot_adamanip.errors import ConfigurationError, require_choice
from lerobot_adamanip.keyframes import DEFAULT_MOTION, MotionLimits
from lerobot_adamanip.mechanisms import MECHANISM_PRESETS, make_mechanism
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.building import build_object, sapien_pose
from lerobot_env_adamanip.sim.keyframe_driver import ArmState, KeyframeDriver
from lerobot_env_adamanip.sim.kinematics import LEVEL_REST, NUM_ARM_JOINTS, ArmKinematics
from lerobot_env_adamanip.sim.placement import Placement, ReachRequirement, draw_placement, randomization
from lerobot_env_adamanip.sim.rendering import keep_shaders
from lerobot_env_adamanip.sim.robot import AdaManipPanda

CAMERA = "front"
CAMERA_EYE, CAMERA_TARGET = (0.0, -0.58, 1.16), (0.60, 0.02, 0.70)
"""Third person, beside and above the arm (paper: one camera adjacent to the robot) [m, base frame]."""
CPU_BACKENDS = ("auto", "cpu", "physx_cpu")
"""Names under which ManiSkill knows CPU physics."""
SWING_REACH = float(np.deg2rad(44))
"""The arm must be able to swing a door this far [rad]: past success, with room for a slack grip."""
LIFT_REACH = 0.045
"""The arm must be able to take a cap or lid this far [m]: past success."""
_LAYOUT_STREAM, _HIDDEN_STREAM, _OBJECT_STREAM, _CAMERA_STREAM = range(4)


class AdaManipTask(BaseEnv):
    """Base of the tasks; a category says where its objects stand and what the arm has to reach.

    Task description: manipulate an articulated object whose mechanism cannot be seen.
    Randomizations: object out of ``objects``; its pose, the arm's start and the camera's pose (``pose_preset``);
        hidden state, from a stream of its own, so that two episodes that differ in it alone look the same.
    Success conditions: a joint beyond its goal, see `Mechanism.goals`.

    CPU physics only: the mechanism changes joint limits at run time, which ManiSkill's GPU simulation forbids.

    ManiSkill's ``state`` observation is the arm's joint positions and velocities alone; neither the object's joints nor
    anything hidden is in it. ``info`` tells the object's joints, which `KeyframeEnv` does not pass on.
    """

    SUPPORTED_ROBOTS: ClassVar[list[str]] = ["adamanip_panda"]
    SUPPORTED_REWARD_MODES: ClassVar[list[str]] = ["sparse", "none"]
    agent: AdaManipPanda
    category: ClassVar[str]
    nominal_x: ClassVar[float] = 0.66
    """Distance of the object's front from the robot's base [m]."""
    part_height: ClassVar[float] = 0.72
    """Where the plinth lifts the first part to [m]."""
    plinth_least: ClassVar[float] = 0.02
    """Half of the plinth's least width and depth [m]."""
    motion: ClassVar[MotionLimits] = DEFAULT_MOTION
    """How the arm moves, and when it gives up."""
    solver_iterations: ClassVar[int] = 15
    """Of the physics engine for positions: how hard what touches is, not how exactly joints are driven."""
    rest: ClassVar[NDArray[np.float64]] = LEVEL_REST
    """The arm's posture at the start, and the one its elbow is drawn to [rad]."""

    def __init__(
        self,
        *args: Any,
        objects: str = "seen",
        assets: str | None = None,
        pose_preset: str = "default",
        mechanism_preset: str = "paper",
        image_size: int = 256,
        shader: str = "default",
        hidden_overrides: Mapping[str, Any] | None = None,
        robot_uids: str = "adamanip_panda",
        num_envs: int = 1,
        sim_backend: str = "auto",
        **kwargs: Any,
    ) -> None:
        if sim_backend not in CPU_BACKENDS:
            raise ConfigurationError(
                "AdaManip tasks need CPU physics: their joint limits change while they run.",
                got=f"sim_backend={sim_backend!r}",
                allowed=", ".join(CPU_BACKENDS),
                hint="leave sim_backend out",
            )
        if num_envs != 1:
            raise ConfigurationError(
                "AdaManip tasks run one environment per process.",
                got=f"num_envs={num_envs}",
                allowed="1",
                hint="gymnasium's AsyncVectorEnv, or lerobot-eval --eval.batch_size=N",
            )
        self.object_ids, self._assets = select_objects(self.category, objects, assets), assets
        self.spread = randomization(pose_preset)
        self.mechanism_preset = require_choice("mechanism preset", mechanism_preset, MECHANISM_PRESETS)
        self.hidden_overrides = dict(hidden_overrides or {})
        self._image_size, self._shader = image_size, shader
        kwargs.setdefault("reconfiguration_freq", 1)
        kwargs.setdefault("render_backend", "cpu" if not torch.cuda.is_available() else "gpu")
        super().__init__(*args, robot_uids=robot_uids, num_envs=1, sim_backend="physx_cpu", **kwargs)

    # What a category defines ------------------------------------------------------------------------------------

    def reaches(self, obj: ArticulatedObject) -> tuple[ReachRequirement, ...]:
        """Returns the part motions the arm has to be able to make."""
        raise NotImplementedError

    # ManiSkill's life cycle -------------------------------------------------------------------------------------

    @property
    def _default_sim_config(self) -> SimConfig:
        scene = SceneConfig(solver_position_iterations=self.solver_iterations)
        return SimConfig(sim_freq=200, control_freq=50, scene_config=scene)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        rng = self._stream(_CAMERA_STREAM)
        spread = self.spread.camera_position
        eye = np.asarray(CAMERA_EYE) + rng.uniform(-spread, spread, 3)
        target = np.asarray(CAMERA_TARGET) + rng.uniform(-spread, spread, 3)
        size = self._image_size
        pose = sapien_utils.look_at(eye, target)
        return [CameraConfig(CAMERA, pose, size, size, np.deg2rad(52), 0.01, 10, shader_pack=self._shader)]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        pose = sapien_utils.look_at(CAMERA_EYE, CAMERA_TARGET)
        return CameraConfig("render_camera", pose, 512, 512, np.deg2rad(52), 0.01, 10)

    def _setup_scene(self) -> None:
        super()._setup_scene()
        if self.scene.can_render():
            keep_shaders(self._render_device)

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        super()._load_agent(options, sapien.Pose())

    def _load_lighting(self, options: dict[str, Any]) -> None:
        self.scene.set_ambient_light([0.35, 0.35, 0.36])
        self.scene.add_directional_light([0.9, 0.5, -1.0], [1.5, 1.45, 1.4], shadow=self.enable_shadow)
        self.scene.add_directional_light([0.6, -0.8, -0.6], [0.6, 0.62, 0.7])

    def _load_scene(self, options: dict[str, Any]) -> None:
        chosen = options.get("object_id") or self._stream(_OBJECT_STREAM).choice(self.object_ids)
        self.obj = get_object(str(chosen), self._assets)
        self.mechanism = make_mechanism(self.obj, self.mechanism_preset)
        self.floor_z = self._floor_height()
        build_ground(self.scene)
        self._plinth = self._build_plinth()
        self.articulation = build_object(self.scene, self.obj, np.eye(4))
        self.kinematics = ArmKinematics(self.agent.robot._objs[0], self.rest)

    def _floor_height(self) -> float:
        return float(np.clip(self.part_height - self.obj.parts[0].grasp[2, 3], 0.04, 0.7))

    def _build_plinth(self) -> Any:
        builder = self.scene.create_actor_builder()
        depth, width = self.obj.size[1] / 2 - 0.02, self.obj.size[0] / 2 - 0.04
        half = [max(depth, self.plinth_least), max(width, self.plinth_least), self.floor_z / 2]
        material = sapien.render.RenderMaterial(base_color=[0.45, 0.36, 0.27, 1.0], roughness=0.8)
        builder.add_box_visual(half_size=half, material=material)
        builder.add_box_collision(half_size=half)
        builder.initial_pose = sapien.Pose([2.0, 0, self.floor_z / 2])
        return builder.build_kinematic(name="plinth")

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        self.layout = draw_placement(
            self._stream(_LAYOUT_STREAM),
            self.obj,
            self.kinematics,
            self.reaches(self.obj),
            self.spread,
            nominal_x=self.nominal_x,
            floor_z=self.floor_z,
        )
        self._place(self.layout)
        generator = torch.Generator().manual_seed(int(self._stream(_HIDDEN_STREAM).integers(2**31)))
        overrides = {**self.hidden_overrides, **(options.get("hidden_overrides") or {})}
        self.mechanism_state = self.mechanism.draw(1, generator, overrides or None)
        self._applied: dict[str, tuple[float, float]] = {}
        self._detent: dict[str, float] | None = None
        self.driver = KeyframeDriver(
            self.kinematics,
            self._arm_state,
            self._tick,
            control_dt=self.control_timestep,
            stiffness=np.asarray(AdaManipPanda.arm_stiffness),
            limits=self.motion,
        )
        self._apply_mechanism()

    def _place(self, layout: Placement) -> None:
        pose = layout.object_in_base
        self.articulation.set_pose(sapien_pose(pose))
        self.articulation.set_qpos(np.zeros((1, self.articulation.max_dof), np.float32))
        plinth = pose.copy()
        plinth[:3, 3] += pose[:3, :3] @ (-self.obj.size[1] / 2, 0.0, 0.0)
        plinth[2, 3] = self.floor_z / 2
        self._plinth.set_pose(sapien_pose(plinth))
        self.agent.reset(np.concatenate([layout.start_qpos, [0.04, 0.04]]).astype(np.float32))

    # Mechanism --------------------------------------------------------------------------------------------------

    def _stream(self, stream: int) -> np.random.Generator:
        """A generator of its own for each kind of draw: the hidden draw leaves every other as it is."""
        return np.random.default_rng([int(self._episode_seed[0]), stream])

    def joint_positions(self) -> dict[str, float]:
        """Returns the object's joint positions [rad or m]: privileged, for mechanism, success and records."""
        raw = self.articulation._objs[0]
        return {
            joint.name.rsplit("_", 1)[-1]: float(q) for joint, q in zip(raw.active_joints, raw.get_qpos(), strict=True)
        }

    def _after_control_step(self) -> None:
        self._apply_mechanism()

    def _apply_mechanism(self) -> None:
        """Writes the mechanism's limits, but for the detent.

        While a key frame does nothing but close the fingers, the joints are held where they are: fingers that close
        unevenly would move what is free, by a fraction of a degree, and tell the hidden state before anything is tried.
        """
        positions = self.joint_positions()
        self._detent = (self._detent or positions) if self.driver.closing else None
        self.mechanism_state, command = self.mechanism.step(self.mechanism_state, _reading(positions))
        for joint in self.articulation._objs[0].active_joints:
            name = joint.name.rsplit("_", 1)[-1]
            limits = (float(command[name].lower[0]), float(command[name].upper[0]))
            if self._detent is not None:
                limits = (self._detent[name], self._detent[name])
            if self._applied.get(name) != limits:
                joint.limits = [list(limits)]
                self._applied[name] = limits

    def hidden_state(self) -> dict[str, Any]:
        """Returns what cannot be seen: privileged, never part of an observation."""
        return self.mechanism.hidden(self.mechanism_state, 0)

    # Arm --------------------------------------------------------------------------------------------------------

    def _arm_state(self) -> ArmState:
        raw = self.agent.robot._objs[0]
        qpos, qvel = np.asarray(raw.get_qpos(), np.float64), np.asarray(raw.get_qvel(), np.float64)
        return ArmState(qpos[:NUM_ARM_JOINTS], qvel[:NUM_ARM_JOINTS], qpos[NUM_ARM_JOINTS:])

    def _tick(self, target: NDArray[np.float64], velocity: NDArray[np.float64], finger: float) -> None:
        if self.driver.closing and self._detent is None:
            self._apply_mechanism()  # before the first tick, not after it
        joints = self.agent.robot._objs[0].active_joints
        for joint, position, speed in zip(joints, target, velocity, strict=False):
            joint.set_drive_target(position)
            joint.set_drive_velocity_target(speed)
        for joint in joints[NUM_ARM_JOINTS:]:
            joint.set_drive_target(finger)
        self._step_action(None)

    # Outcome ----------------------------------------------------------------------------------------------------

    def evaluate(self) -> dict[str, Any]:
        """Returns success and the object's joint positions [rad or m]."""
        reading = _reading(self.joint_positions())
        return {"success": self.mechanism.succeeded(reading), **reading}

    def compute_sparse_reward(self, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
        """1 while the success conditions hold."""
        reward: torch.Tensor = info["success"].float()
        return reward


def _reading(positions: Mapping[str, float]) -> dict[str, torch.Tensor]:
    """A mechanism's reading of one environment."""
    return {name: torch.tensor([position]) for name, position in positions.items()}


def turn_then_open(obj: ArticulatedObject, part: str, key: str, final: str, far: float) -> ReachRequirement:
    """Returns the reach of a part that turns through all of its key joint's range, and opens by ``far`` from there."""
    paths = [({key: turn}, {key: turn, final: far}) for turn in obj.joint(key).limits if turn]
    return ReachRequirement(part, *paths)
