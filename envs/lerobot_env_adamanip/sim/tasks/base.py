"""Base of the ManiSkill tasks: one object on a plinth in front of a Panda, one camera, one hidden mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.structs.types import SceneConfig, SimConfig
from numpy.typing import NDArray

from lerobot_adamanip.catalog import get_object, select_objects
from lerobot_adamanip.contract.cameras import CAMERAS
from lerobot_adamanip.contract.keyframes import Feedback
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, DEPTH_SIZE, Workspace
from lerobot_adamanip.contract.seeds import BalancedDraws, Stream, episode_generator
from lerobot_adamanip.episode.tries import TryTracker
from lerobot_adamanip.mechanisms import MECHANISM_RULES, Mechanism, make_mechanism
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_env_adamanip.cloud_source import resolve_cloud_source
from lerobot_env_adamanip.sim import scene
from lerobot_env_adamanip.sim.contacts import ArmContacts
from lerobot_env_adamanip.sim.control_tick import CONTACT_OFFSET, Closing, ControlTick, drive_targets, finger_target
from lerobot_env_adamanip.sim.keyframe_driver import ArmState, KeyframeDriver
from lerobot_env_adamanip.sim.kinematics import NUM_ARM_JOINTS, ArmKinematics
from lerobot_env_adamanip.sim.mechanism_driver import MechanismDriver
from lerobot_env_adamanip.sim.placement import Placement, randomization
from lerobot_env_adamanip.sim.reachability import placement_check
from lerobot_env_adamanip.sim.renderer import device_for, keep_shaders, translate_renderer_errors, without_reflections
from lerobot_env_adamanip.sim.robot import AdaManipPanda
from lerobot_env_adamanip.sim.tasks.category_task import CategoryTask
from lerobot_env_adamanip.sim.views import SimObservation, Views

CPU_BACKENDS = ("auto", "cpu", "physx_cpu")
"""ManiSkill's names for CPU physics."""


class AdaManipTask(BaseEnv):
    """A task of the category in its `CategoryTask`.

    Task description: manipulate an articulated object with a hidden mechanism.
    Randomizations: object (``objects``); poses of object, arm and camera (``poses``); hidden state, from a separate
        random stream: episodes that differ only in it look the same.
    Success conditions: a joint beyond its goal, see `Mechanism.goals`.

    CPU physics only: the mechanism changes joint limits at run time, which ManiSkill's GPU simulation does not allow.

    ManiSkill's ``state`` observation is the arm's joint positions and velocities.
    ``info`` has the success alone. Joints are held until a try, in every control mode (see `MechanismDriver`).
    """

    SUPPORTED_ROBOTS: ClassVar[list[str]] = ["adamanip_panda"]
    SUPPORTED_REWARD_MODES: ClassVar[list[str]] = ["sparse", "none"]
    agent: AdaManipPanda
    definition: ClassVar[CategoryTask]
    """Row of the category in the table of tasks."""
    placement: Placement
    """Poses of this episode, and the annotated parts in the robot's base frame."""
    holds_joints: bool = True
    """Whether joints are held until a try; read at reset. If False, observations reveal the hidden state."""
    mechanism_driver: MechanismDriver
    """Mechanism of this episode, with its object."""
    tries: TryTracker
    """Tries of this episode."""
    views: Views
    """Cameras of this episode."""
    _is_built = False
    """Whether ManiSkill's own first reset is over; its scene may be unreachable."""

    def __init__(
        self,
        *args: Any,
        objects: str = "seen",
        assets: str | None = None,
        poses: str = "randomized",
        mechanism_rules: str = "paper",
        image_size: int = 256,
        depth_size: int = DEPTH_SIZE,
        shader: str = "default",
        render_backend: str = "auto",
        cloud_source: str = "raycast",
        workspace: Workspace = DEFAULT_WORKSPACE,
        hidden_overrides: Mapping[str, Any] | None = None,
        robot_uids: str = "adamanip_panda",
        num_envs: int = 1,
        sim_backend: str = "auto",
        **kwargs: Any,
    ) -> None:
        _require_one_on_cpu(sim_backend, num_envs)
        placeable = None if assets is None else placement_check(self.definition, poses)
        self.object_ids, self._assets = select_objects(self.category, objects, assets, placeable), assets
        self.randomization = randomization(poses)
        self.mechanism_rules = require_choice("mechanism rules", mechanism_rules, MECHANISM_RULES)
        self.hidden_overrides = dict(hidden_overrides or {})
        self._image_size, self._depth_size, self._shader, self._workspace = image_size, depth_size, shader, workspace
        self._cloud_source, self._renderer = resolve_cloud_source(cloud_source), render_backend
        kwargs.setdefault("reconfiguration_freq", 1)
        device = device_for(render_backend, kwargs)
        kwargs |= {"robot_uids": robot_uids, "sim_backend": "physx_cpu", "render_backend": device}
        with translate_renderer_errors():
            super().__init__(*args, num_envs=1, **kwargs)
        self._is_built = True

    @property
    def category(self) -> str:
        """Name of the category."""
        return self.definition.category

    # For `KeyframeEnv` ----------------------------------------------------------------------------------------------

    def execute(self, action: NDArray[np.float32]) -> Feedback:
        """Runs one key frame from a (10,) action of the contract; see `KeyframeDriver.execute`."""
        return self._arm.execute(action)

    def observe(self, *, image: bool = True) -> SimObservation:
        """Returns the present observation, with images if ``image``."""
        points, arm = self.views.points(), self.arm_state()
        images = {name: self.views.image(name) for name in (CAMERAS if image else ())}
        return SimObservation(images, points, arm.qpos, arm.qvel, self.effort, self.feedback)

    @property
    def obj(self) -> ArticulatedObject:
        """Object of this episode."""
        return self._objects.obj

    @property
    def mechanism(self) -> Mechanism[Any]:
        """Mechanism of this episode's object."""
        return self.mechanism_driver.mechanism

    @property
    def feedback(self) -> Feedback:
        """Feedback of the latest key frame."""
        return self._arm.feedback

    @property
    def effort(self) -> NDArray[np.float64]:
        """External joint torque (7,) [N m] at the end of the latest key frame."""
        return self._arm.effort

    @property
    def goal(self) -> tuple[NDArray[np.float64], float]:
        """Commanded tool pose (4, 4), after clipping, and gripper opening of the latest key frame."""
        return self._arm.goal

    def arm_state(self) -> ArmState:
        """Returns the present state of the arm's joints."""
        raw = self.agent.robot._objs[0]
        qpos, qvel = np.asarray(raw.get_qpos(), np.float64), np.asarray(raw.get_qvel(), np.float64)
        return ArmState(qpos[:NUM_ARM_JOINTS], qvel[:NUM_ARM_JOINTS], qpos[NUM_ARM_JOINTS:])

    def joint_positions(self) -> dict[str, float]:
        """Returns the object's joint positions [rad or m]; privileged, for mechanism, success and records."""
        return self.mechanism_driver.joint_positions()

    def hidden_state(self) -> dict[str, Any]:
        """Returns the hidden state; privileged, never part of an observation."""
        return self.mechanism_driver.hidden_state()

    def succeeded(self) -> bool:
        """Returns whether the task has succeeded."""
        return self.mechanism_driver.succeeded()

    def restart_tries(self) -> None:
        """Forgets all tries so far."""
        kinds = {name: self.obj.joint(name).kind for name in self.mechanism.joints}
        self.tries = TryTracker(kinds, self.joint_positions())

    # ManiSkill's life cycle -------------------------------------------------------------------------------------

    @property
    def _default_sim_config(self) -> SimConfig:
        iterations = self.definition.solver_iterations
        config = SceneConfig(solver_position_iterations=iterations, contact_offset=CONTACT_OFFSET)
        return SimConfig(sim_freq=200, control_freq=50, scene_config=config)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        """Returns the cameras of plain ManiSkill; those of key frames are in `views`."""
        names = () if self._obs_mode == "none" else CAMERAS
        cameras = [self._camera(self._image_size, name) for name in names]
        return [without_reflections(camera) for camera in cameras] if self.scene.can_render() else cameras

    def _camera(self, size: int, name: str) -> CameraConfig:
        poses = scene.draw_cameras(self._stream(Stream.CAMERA), self.randomization.camera_position)
        return scene.camera_config(name, poses[name], size, self._shader)

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        return scene.person_camera()

    def _clear(self) -> None:
        with scene.without_full_gc():
            super()._clear()

    def _setup_scene(self) -> None:
        super()._setup_scene()
        if self.scene.can_render():
            keep_shaders(self._render_device)

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        super()._load_agent(options, sapien.Pose())

    def _load_lighting(self, options: dict[str, Any]) -> None:
        scene.add_lights(self.scene, shadow=self.enable_shadow)

    def _load_scene(self, options: dict[str, Any]) -> None:
        chosen = options.get("object_id") or self._stream(Stream.OBJECT).choice(self.object_ids)
        obj, task = get_object(str(chosen), self._assets), self.definition
        self._rules = make_mechanism(obj, self.mechanism_rules)
        self._stand = task.stand(obj)
        self._objects = scene.ObjectScene(
            self.scene,
            obj,
            floor_z=self._stand.floor_z,
            ground_z=self._stand.ground_z,
            plinth_least=task.plinth_least,
        )
        self._kinematics = ArmKinematics(self.agent.robot._objs[0], task.rest)

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        rng, spread = self._stream(Stream.PLACEMENT), self.randomization
        self.placement = self._stand.draw(rng, self.obj, self._kinematics, spread, must_reach=self._is_built)
        self._objects.place(self.placement.object_in_base)
        self.agent.reset(np.concatenate([self.placement.start_qpos, [0.04, 0.04]]).astype(np.float32))
        overrides = {**self.hidden_overrides, **(options.get("hidden_overrides") or {})}
        state = self._rules.draw(BalancedDraws(int(self._episode_seed[0]), self.category), overrides)
        arm, target = self.agent.robot._objs[0], self._objects.articulation._objs[0]
        self.mechanism_driver = MechanismDriver(self._rules, state, target, hold=self.holds_joints)
        self.restart_tries()
        self._contacts = ArmContacts(system := self.scene.sub_scenes[0].physx_system, arm, target, self.obj)
        self._closing = Closing()
        self._control_tick = ControlTick(system, arm, steps=self._sim_steps_per_control)
        self._arm = KeyframeDriver(
            self._kinematics,
            self.arm_state,
            self._tick,
            control_dt=self.control_timestep,
            stiffness=np.asarray(AdaManipPanda.arm_stiffness),
            limits=self.definition.motion,
        )
        self.views = Views(
            self._objects,
            self.agent,
            self._camera,
            self._image_size,
            self._depth_size,
            self._workspace,
            self._renderer,
            self._cloud_source,
        )

    def _stream(self, stream: Stream) -> np.random.Generator:
        return episode_generator(int(self._episode_seed[0]), stream, self.category)

    def _after_control_step(self) -> None:
        """Runs after each of ManiSkill's control steps; key frames have their own ticks, see `_tick`."""
        self._follow_tries(drive_targets(self.agent.robot._objs[0]))

    def _tick(self, target: NDArray[np.float64], velocity: NDArray[np.float64], finger: float) -> None:
        """Runs one control tick of a key frame."""
        self._control_tick.run(target, velocity, finger)
        self._follow_tries(target)

    def _follow_tries(self, target: NDArray[np.float64]) -> None:
        """Follows tries for one control tick with joint targets (7,) [rad], and holds and releases joints by them."""
        pushes = self._contacts.pushes(*map(self._kinematics.tcp_in_base, (target, self.arm_state().qpos)))
        closing = self._closing.update(target, finger_target(self.agent.robot._objs[0]))
        self.tries.update({} if closing else pushes, self.joint_positions())
        self.mechanism_driver.apply(self.mechanism.joints if closing else self.tries.at_rest())

    # Outcome ----------------------------------------------------------------------------------------------------

    def evaluate(self) -> dict[str, Any]:
        """Returns success, a tensor (1,)."""
        return {"success": torch.tensor([self.mechanism_driver.succeeded()])}

    def compute_sparse_reward(self, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
        """Returns 1 while the task has succeeded."""
        reward: torch.Tensor = info["success"].float()
        return reward


def _require_one_on_cpu(sim_backend: str, num_envs: int) -> None:
    """Raises `ConfigurationError` for GPU physics or several environments in one process."""
    if sim_backend not in CPU_BACKENDS or num_envs != 1:
        raise ConfigurationError(
            "AdaManip tasks run one environment per process on CPU physics: their joint limits change at run time.",
            got=f"sim_backend={sim_backend!r}, num_envs={num_envs}",
            allowed=f"sim_backend {', '.join(CPU_BACKENDS)}; num_envs 1",
            hint="leave both out; several environments: gymnasium's AsyncVectorEnv, lerobot-eval --eval.batch_size=N",
        )
