"""Base of the ManiSkill tasks: one object on a plinth in front of a Panda, one camera, one hidden mechanism."""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.structs.types import SceneConfig, SimConfig
from numpy.typing import NDArray

from lerobot_adamanip.catalog import get_object, select_objects
from lerobot_adamanip.contract.cameras import CAMERAS, FRONT
from lerobot_adamanip.contract.keyframes import Feedback
from lerobot_adamanip.contract.seeds import BalancedDraws, Stream, episode_generator
from lerobot_adamanip.contract.sensing import EXACT, Sensing, parse_sensing
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.hardware.calibration.self_calibration import SelfCalibration
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_env_adamanip.gym_interface import RESET_OPTIONS, reset_options
from lerobot_env_adamanip.sim import scene
from lerobot_env_adamanip.sim.arm_driver import TICKS_PER_SECOND, ArmDriver
from lerobot_env_adamanip.sim.cameras import Cameras
from lerobot_env_adamanip.sim.hand_surface import hand_surface
from lerobot_env_adamanip.sim.kinematics import ArmKinematics
from lerobot_env_adamanip.sim.placement import Placement, placement_check, randomization
from lerobot_env_adamanip.sim.render_device import resolve_cloud_source
from lerobot_env_adamanip.sim.renderer import device_for, keep_shaders, translate_renderer_errors, without_reflections
from lerobot_env_adamanip.sim.robot import AdaManipPanda
from lerobot_env_adamanip.sim.sensing import SensorErrors
from lerobot_env_adamanip.sim.simulation import CONTACT_OFFSET, Simulation
from lerobot_env_adamanip.sim.tasks.category_task import CategoryTask

CPU_BACKENDS = ("auto", "cpu", "physx_cpu")
"""ManiSkill's names for CPU physics."""
READ_OPTIONS = (
    "objects", "assets", "poses", "mechanism_rules", "hidden_overrides", "image_size", "render_backend", "num_points",
    "workspace", "cloud_source", "sensing", "self_calibration",
)  # fmt: skip
"""Options that a task reads; splits of scenes, limits, memories and logs are those of `KeyframeEnv`."""
_OF_OUR_CAMERAS = ("num_points", "workspace", "cloud_source", "sensing", "self_calibration")
"""Those of them that only `AdaManipTask.cameras` follows, not ManiSkill's own observations."""
_OTHER_OPTIONS = {item.name for item in fields(EnvironmentOptions)} - {*READ_OPTIONS, "category"}


class AdaManipTask(BaseEnv):
    """A task of the category in its `CategoryTask`. Each reset makes the episode's `Simulation`, driver and cameras.

    Task description: manipulate an articulated object with a hidden mechanism.
    Randomizations: object (``objects``); poses of object, arm and camera (``poses``); hidden state, from a separate
        random stream: episodes that differ only in it look the same.
    Success conditions: a joint beyond its goal, see `Mechanism.goals`.

    CPU physics only: the mechanism changes joint limits at run time, which ManiSkill's GPU simulation does not allow.

    ManiSkill's ``state`` observation is the arm's joint positions and velocities.
    ``info`` has the success alone. Joints are held until a try, in every control mode (see `Simulation`).

    Args:
        options: all options of this project at once ...
        shader: shader pack of the cameras.
        kwargs: ... or some of `READ_OPTIONS` by name, and ManiSkill's own.
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
    simulation: Simulation
    """Simulation of this episode."""
    driver: ArmDriver
    """Driver of the arm in this episode, which executes key frames."""
    cameras: Cameras
    """Cameras of this episode."""
    errors: SensorErrors | None
    """Errors of this episode's sensors; None without errors."""
    _is_built = False
    """Whether ManiSkill's own first reset is over; its scene may be unreachable."""

    def __init__(
        self,
        *args: Any,
        options: EnvironmentOptions | None = None,
        shader: str = "default",
        robot_uids: str = "adamanip_panda",
        num_envs: int = 1,
        sim_backend: str = "auto",
        **kwargs: Any,
    ) -> None:
        if sim_backend not in CPU_BACKENDS or num_envs != 1:
            raise ConfigurationError(
                "AdaManip tasks run one environment per process on CPU physics: their joint limits change at run time.",
                got=f"sim_backend={sim_backend!r}, num_envs={num_envs}",
                allowed=f"sim_backend {', '.join(CPU_BACKENDS)}; num_envs 1",
                hint="leave both out; for several: gymnasium's AsyncVectorEnv, or lerobot-eval --eval.batch_size=N",
            )
        require_choice("robot", robot_uids, self.SUPPORTED_ROBOTS)
        for name in _OTHER_OPTIONS & kwargs.keys():
            require_choice("option of a ManiSkill task", name, READ_OPTIONS, hint="KeyframeEnv or DenseEnv")
        if str(kwargs.get("obs_mode") or "none") not in ("none", "state", "state_dict"):
            for name in kwargs.keys() & _OF_OUR_CAMERAS:
                raise ConfigurationError(
                    "ManiSkill's own observations have exact sensors and its own clouds.",
                    got=f"{name}={kwargs[name]!r}, obs_mode={kwargs['obs_mode']!r}",
                    allowed="obs_mode 'none' or 'state', where `cameras` of the task follows this option",
                    hint="AdaManipKeyframe-Safe-v0 or AdaManipDense-Safe-v0, whose observations follow it",
                )
        values = {name: kwargs.pop(name) for name in READ_OPTIONS if name in kwargs}
        options = (options or EnvironmentOptions()).changed(category=self.category, **values)
        self.options = options.changed(cloud_source=resolve_cloud_source(options.cloud_source))
        self.randomization, self._shader = randomization(options.poses), shader
        self._sensing = None if options.sensing == EXACT else parse_sensing(options.sensing)
        placeable = None if options.assets is None else placement_check(self.definition, options.poses)
        self.object_ids = select_objects(self.category, options.objects, options.assets, placeable)
        kwargs.setdefault("reconfiguration_freq", 1)
        device = device_for(options.render_backend, kwargs)
        kwargs |= {"robot_uids": robot_uids, "sim_backend": "physx_cpu", "render_backend": device}
        with translate_renderer_errors():
            super().__init__(*args, num_envs=1, **kwargs)
        self._is_built = True

    @property
    def category(self) -> str:
        """Name of the category."""
        return self.definition.category

    def execute(self, action: NDArray[np.float32]) -> Feedback:
        """Runs one key frame from a (10,) action of the contract; see `ArmDriver.motion`."""
        return self.driver.execute(action)

    # ManiSkill's life cycle -------------------------------------------------------------------------------------

    @property
    def _default_sim_config(self) -> SimConfig:
        iterations = self.definition.solver_iterations
        config = SceneConfig(solver_position_iterations=iterations, contact_offset=CONTACT_OFFSET)
        return SimConfig(sim_freq=200, control_freq=50, scene_config=config)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        """Returns the cameras of plain ManiSkill; those of key frames are in `cameras`."""
        if self._obs_mode == "none":
            return []
        size, poses = self.options.image_size, self._camera_poses()
        configs = [
            scene.camera_config(
                *(name, poses[name], size, self._shader), mount=self.agent.robot.links_map.get(CAMERAS[name].link)
            )
            for name in CAMERAS
        ]
        return [without_reflections(config) for config in configs] if self.scene.can_render() else configs

    def _camera_poses(self) -> dict[str, Any]:
        return scene.draw_cameras(self._stream(Stream.CAMERA), self.randomization.camera_position)

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
        reset_options(self.options, None, {name: options[name] for name in RESET_OPTIONS if name in options})
        chosen = options.get("object_id") or self._stream(Stream.OBJECT).choice(self.object_ids)
        self._obj, task = get_object(str(chosen), self.options.assets), self.definition
        self._mechanism = make_mechanism(self._obj, self.options.mechanism_rules)
        self._stand = task.stand(self._obj)
        self._objects = scene.ObjectScene(
            self.scene,
            self._obj,
            floor_z=self._stand.floor_z,
            ground_z=self._stand.ground_z,
            plinth_least=task.plinth_least,
        )
        self._kinematics = ArmKinematics(self.agent.robot._objs[0], task.rest)

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        rng, spread = self._stream(Stream.PLACEMENT), self.randomization
        self.placement = self._stand.draw(rng, self._obj, self._kinematics, spread, must_reach=self._is_built)
        self._objects.place(self.placement.object_in_base)
        self.agent.reset(np.concatenate([self.placement.start_qpos, [0.04, 0.04]]).astype(np.float32))
        overrides = {**self.options.hidden_overrides, **(options.get("hidden_overrides") or {})}
        arm = self.agent.robot._objs[0]
        arm.set_solver_position_iterations(self.definition.solver_iterations)  # an arm that is kept has those of before
        self.simulation = Simulation(
            self.scene.sub_scenes[0].physx_system,
            arm,
            self._objects.articulation._objs[0],
            kinematics=self._kinematics,
            obj=self._obj,
            mechanism=self._mechanism,
            state=self._mechanism.draw(BalancedDraws(int(self._episode_seed[0]), self.category), overrides),
            steps=self._sim_steps_per_control,
            hold=self.holds_joints,
        )
        self.driver = ArmDriver(
            self.simulation,
            control_dt=self.control_timestep,
            stiffness=np.asarray(AdaManipPanda.arm_stiffness),
            limits=self.definition.motion,
        )
        urdf, poses = Path(self.agent.urdf_path), self._camera_poses()
        self.errors, calibration = None, None
        if self.options.self_calibration:
            calibration = SelfCalibration(hand_surface(arm, urdf), np.asarray(poses[FRONT].p, np.float64))
        if self._sensing is not None:
            self.errors = errors = self._draw_errors(self._sensing, self.simulation)
            poses = {name: scene.moved_camera(pose, partial(errors.true_pose, name)) for name, pose in poses.items()}
        self.cameras = Cameras(self._objects, arm, urdf, poses, self.options, self._shader, self.errors, calibration)

    def _draw_errors(self, sensing: Sensing, simulation: Simulation) -> SensorErrors:
        fps = self.options.fps
        steps = sensing.steps_late(fps) if self.options.is_dense else 0
        return SensorErrors(
            sensing,
            int(self._episode_seed[0]),
            self.category,
            self.options.workspace,
            moment=lambda: simulation.ticks,
            delay=steps * TICKS_PER_SECOND // fps,
        )

    def _stream(self, stream: Stream) -> np.random.Generator:
        return episode_generator(int(self._episode_seed[0]), stream, self.category)

    def set_state_dict(self, state: dict[str, Any], env_idx: torch.Tensor | None = None) -> None:
        """Raises `ConfigurationError`: a state has neither mechanism nor tries, and joints would move back."""
        raise ConfigurationError(
            "The state of an AdaManip task cannot be set.",
            got="set_state or set_state_dict",
            allowed="a reset with a seed, then the same actions",
            hint="adamanip replay DIR, for recorded episodes",
        )

    def _after_control_step(self) -> None:
        """Runs after each of ManiSkill's control steps; key frames have their own ticks, see `Simulation.tick`."""
        self.simulation.follow_control_step()

    # Outcome ----------------------------------------------------------------------------------------------------

    def evaluate(self) -> dict[str, Any]:
        """Returns success, a tensor (1,)."""
        return {"success": torch.tensor([self.simulation.succeeded()])}

    def compute_sparse_reward(self, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
        """Returns 1 while the task has succeeded."""
        reward: torch.Tensor = info["success"].float()
        return reward
