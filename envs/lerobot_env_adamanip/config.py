"""LeRobot's environment configurations: ``--env.type=adamanip_safe``. Imports no simulator."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from lerobot_adamanip.contract.cameras import camera_names, image_column
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, DENSE, EE_DELTA, KEYFRAME, POSE, STATES
from lerobot_adamanip.contract.memory import EVENTS, MEMORY, MEMORY_NAMES, NO_MEMORY
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.contract.schema import (
    ACTION,
    ACTION_DIM,
    DEFAULT_NUM_POINTS,
    EFFORT,
    IMAGE_SIZE,
    NUM_JOINTS,
    POINT_CLOUD,
    STATE,
    STATE_DIM,
)
from lerobot_adamanip.contract.seeds import category_offset
from lerobot_adamanip.contract.sensing import EXACT
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError, shown_by_parsers
from lerobot_env_adamanip.sim.render_device import observes_images

if TYPE_CHECKING:
    import gymnasium as gym


def hidden_value() -> Any:
    """Returns a field that fixes a hidden value by its name; None samples it."""
    return field(default=None, metadata={"hidden": True})


@dataclass
class AdaManipEnvConfig(EnvConfig):
    """Options of all environments; see `lerobot_adamanip.episode.options.EnvironmentOptions`."""

    category: ClassVar[str] = ""

    # Name of the environment in LeRobot's logs; by default the category's.
    task: str | None = None
    # Must be 1: LeRobot's parallel tasks share one policy object, whose history would mix their episodes.
    max_parallel_tasks: int = 1
    # Without effect: LeRobot's commands do not create these environments by gymnasium.make.
    disable_env_checker: bool = True
    # Control: keyframe (a step is one key frame), or dense (a step is 1/fps seconds), for any policy of LeRobot.
    control: str = KEYFRAME
    # Steps per second of dense control: 5, 10 (default) or 25.
    fps: int | None = None
    # Dense action: ee_delta (7 numbers in -1 ... 1, a motion from the measured tool pose), ee_pose (10), or joint (8).
    action: str = EE_DELTA
    # Dense state: pose (8 numbers: position, rotation vector, fingers), or full (24, as key frames have it).
    state: str = POSE
    # Whether dense observations hold the point cloud.
    observe_cloud: bool = False
    # Whether dense observations hold the effort.
    observe_effort: bool = False
    # Memory of felt tries: events (numbers in observation.environment_state, for ACT and diffusion), text (a sentence
    # after the instruction, for SmolVLA and pi0.5), or none.
    memory: str = NO_MEMORY
    # Objects: seen (the paper's number), unseen (the next 20), novel, unseen_test and novel_test (20 more of each, for
    # reported numbers), FIRST:END, nFIRST:nEND (novel ones), or ids separated by commas.
    objects: str = "seen"
    # Folder of external assets to use (AdaManip, UniDoorManip or PartNet-Mobility), see docs/annotate.md.
    assets: str | None = None
    # Points in observation.point_cloud, in farthest-point order: a policy with fewer points uses the first ones.
    num_points: int = DEFAULT_NUM_POINTS
    # Side length of an image [px].
    image_size: int = IMAGE_SIZE
    # Whether to observe images: true, false, or unset (if their source works on this machine). Faster if false.
    observe_images: bool | None = None
    # Cameras of the images: '[front,wrist]'; unset for all in dense control and front alone in key frames.
    cameras: list[str] | None = None
    # Names of these cameras in observations, in the same order, as a checkpoint has them: '[camera1,camera2]'.
    camera_names: list[str] | None = None
    # Source of images: raycast (any machine) or render (needs Vulkan); unset for raycast in dense control.
    image_source: str | None = None
    # Poses of object, robot and camera: randomized (sampled), or fixed (nominal, as upstream).
    poses: str = "randomized"
    # Rules of mechanisms: paper (its text), upstream (its code), hard (for pressure_cooker and coffee_maker), row
    # (three locks in a row), or changing (a lock that may shut again).
    mechanism_rules: str = "paper"
    # Maximum steps per episode; by default 45 key frames, or 30 seconds of dense control.
    episode_length: int | None = None
    # Maximum failed tries per episode; the next failed try ends it. A number, or best (worst case of the best strategy
    # without the hidden state); unset for no limit.
    max_failed_tries: str | None = None
    # Share of episodes whose instruction says what is hidden, as "Open the door. It turns left."; 0.5 for half of them.
    hints: float = 0.0
    # Episodes in a row that play one scene, with its hidden state; more than 1 needs --eval.batch_size=1.
    repeats: int = 1
    # Split of scenes, without overlap: train, validation (for selection), or test (for reported numbers).
    split: str = "validation"
    # Also accept a policy that was trained on other categories.
    other_categories: bool = False
    # Source of point clouds: raycast (no renderer), or render (six times slower). The clouds are equal above the
    # ground, which ray-cast ones do not have.
    cloud_source: str = "raycast"
    # Errors of sensors: exact, d435 (a calibrated D435), rough, or one of them with single parts changed, for instance
    # d435,camera_error_mm=20. See docs/sensing.md.
    sensing: str = EXACT
    # Whether to correct each cloud by the robot's hand in it, whose shape and pose are known.
    self_calibration: bool = False
    # Rendering device: cuda, cpu, or auto: the first of them that renders on this machine.
    render_backend: str = "auto"
    # Lower corner of the workspace box that crops point clouds: x, y, z in the robot base frame [m].
    workspace_lower: tuple[float, float, float] = DEFAULT_WORKSPACE.lower
    # Upper corner of the workspace box [m].
    workspace_upper: tuple[float, float, float] = DEFAULT_WORKSPACE.upper
    # File to append each episode's record to (seed, object, hidden state, success, tries), for `adamanip report`.
    episode_log: str | None = None
    # Half-open range of seeds to log: [1000,1005] for --seed=1000 --eval.n_episodes=5. LeRobot runs whole batches and
    # counts the first n_episodes; if unset, the log also has the surplus of the last batch.
    logged_seeds: tuple[int, int] | None = None
    # Label of these episodes in the log, for instance the policy's name.
    run_label: str | None = None
    # Set automatically: shapes of observations and action.
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    # Set automatically: their names in datasets.
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fills features from the options.

        Raises:
            AdaManipError: a value is invalid. Raised here, before a training's first evaluation.
        """
        with shown_by_parsers():
            if self.max_parallel_tasks != 1:
                what, hint = "Parallel tasks would mix the histories of one policy object.", "--eval.batch_size=4"
                raise ConfigurationError(
                    what, got=f"max_parallel_tasks={self.max_parallel_tasks}", allowed=1, hint=hint
                )
            for group in self._groups().values():
                self._options(**group)
            chosen = self.shared_options
            names = camera_names(chosen.observed_cameras, self.camera_names)
        self.task = self.task or self.category
        dims = {"action": ACTION_DIM, "state": STATE_DIM}
        if chosen.is_dense:
            dims = {"action": len(ACTION_NAMES[chosen.action]), "state": len(STATES[chosen.state])}
        table: dict[str, tuple[FeatureType, tuple[int, ...], str]] = {
            "action": (FeatureType.ACTION, (dims["action"],), ACTION),
            "agent_pos": (FeatureType.STATE, (dims["state"],), STATE),
        }
        if chosen.observes_effort:
            table["effort"] = (FeatureType.STATE, (NUM_JOINTS,), EFFORT)
        if chosen.observes_cloud:
            table["point_cloud"] = (FeatureType.ENV, (3 * self.num_points,), POINT_CLOUD)
        if chosen.memory == EVENTS:
            table["environment_state"] = (FeatureType.ENV, (len(MEMORY_NAMES),), MEMORY)
        for name in names.values() if self.observe_images is not False else ():
            # LeRobot's recordings take these keys for columns, whose names have no "/".
            shape = (self.image_size, self.image_size, 3)
            table[image_column(name)] = (FeatureType.VISUAL, shape, image_column(name))
        self.features = {key: PolicyFeature(kind, shape) for key, (kind, shape, _) in table.items()}
        self.features_map = {key: name for key, (_, _, name) in table.items()}

    @property
    def hidden_overrides(self) -> dict[str, bool | int]:
        """Returns the hidden values that the options fix; others are sampled."""
        names = [item.name for item in fields(self) if item.metadata.get("hidden")]
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    @property
    def options(self) -> EnvironmentOptions:
        """The environment's options."""
        return self._options(self.category)

    @property
    def shared_options(self) -> EnvironmentOptions:
        """Options of the first environment, for what all have in common."""
        return self._options(**next(iter(self._groups().values())))

    def _options(self, category: str, **others: Any) -> EnvironmentOptions:
        shared = [item.name for item in fields(EnvironmentOptions) if item.name != "category"]
        values = {name: getattr(self, name) for name in shared if hasattr(self, name)}
        workspace = Workspace(self.workspace_lower, self.workspace_upper)
        values |= {"category": category, "workspace": workspace}
        if self.fps is None:
            del values["fps"]
        if self.episode_length is not None:
            values["max_steps" if self.control == DENSE else "max_key_frames"] = self.episode_length
        return EnvironmentOptions(**{**values, **others})

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `KeyframeEnv` or `DenseEnv`."""
        return {"options": self.options}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv[Any, Any, Any]]]:
        """Returns ``{type: {0: vector environment}}``; removes images from the features if nothing draws them.

        Raises:
            ConfigurationError: the policy of ``--policy.path`` was trained on other categories or other observations.
            SimulatorError: images are requested, but this machine cannot render.
        """
        from lerobot_adamanip.evaluation.record import new_run_id
        from lerobot_adamanip.mechanisms.table import unchanged_rules
        from lerobot_env_adamanip.policy_check import require_fitting_policy
        from lerobot_env_adamanip.vector import make_vector_env

        if line := unchanged_rules([group["category"] for group in self._groups().values()], self.mechanism_rules):
            logging.getLogger(__name__).warning(line)
        shared = self.shared_options
        names = camera_names(shared.observed_cameras, self.camera_names)
        observed = observes_images(self.observe_images, shared.images_from)
        if not observed:
            self.features = {key: one for key, one in self.features.items() if one.type is not FeatureType.VISUAL}
        run_id = new_run_id() if self.episode_log else None  # shared by all environments in the log
        common: dict[str, Any] = {"observe_images": observed, "run_id": run_id}
        options = {name: self._options(**group, **common) for name, group in self._groups().items()}
        require_fitting_policy(self, [one.category for one in options.values()])
        return {name: {0: make_vector_env(one, n_envs, use_async_envs, names)} for name, one in options.items()}

    def _groups(self) -> dict[str, dict[str, Any]]:
        """Returns name -> options of each vector environment."""
        return {self.type: {"category": self.category}}


@dataclass
class _TurnToOpenEnvConfig(AdaManipEnvConfig):
    """Object that turns in one hidden direction and then opens."""

    # Hidden direction for all episodes: 1 or -1; unset to sample it.
    direction: int | None = hidden_value()


@EnvConfig.register_subclass("adamanip_bottle")
@dataclass
class AdaManipBottleEnvConfig(_TurnToOpenEnvConfig):
    """Turn a bottle's cap, in a hidden direction and by a hidden angle, and lift it."""

    category: ClassVar[str] = "bottle"


@EnvConfig.register_subclass("adamanip_pen")
@dataclass
class AdaManipPenEnvConfig(_TurnToOpenEnvConfig):
    """Turn a pen's cap, in a hidden direction and by a hidden angle, and lift it."""

    category: ClassVar[str] = "pen"


@EnvConfig.register_subclass("adamanip_pressure_cooker")
@dataclass
class AdaManipPressureCookerEnvConfig(_TurnToOpenEnvConfig):
    """Turn a pressure cooker's lid by its handle, in a hidden direction and by a hidden angle, and lift it."""

    category: ClassVar[str] = "pressure_cooker"


@EnvConfig.register_subclass("adamanip_coffee_maker")
@dataclass
class AdaManipCoffeeMakerEnvConfig(_TurnToOpenEnvConfig):
    """Turn a portafilter by its handle, in a hidden direction and by a hidden angle, and lower it."""

    category: ClassVar[str] = "coffee_maker"


@EnvConfig.register_subclass("adamanip_safe")
@dataclass
class AdaManipSafeEnvConfig(AdaManipEnvConfig):
    """Open a safe that may be locked; a knob that turns in either direction unlocks it."""

    category: ClassVar[str] = "safe"

    # Hidden lock for all episodes: true or false; unset to sample it.
    locked: bool | None = hidden_value()


@EnvConfig.register_subclass("adamanip_microwave")
@dataclass
class AdaManipMicrowaveEnvConfig(AdaManipEnvConfig):
    """Open a microwave that may be locked; a button releases its door."""

    category: ClassVar[str] = "microwave"

    # Hidden lock for all episodes: true or false; unset to sample it.
    locked: bool | None = hidden_value()


@EnvConfig.register_subclass("adamanip_window")
@dataclass
class AdaManipWindowEnvConfig(_TurnToOpenEnvConfig):
    """Turn a window's handle, in a hidden direction and by a hidden angle, and pull the sash open."""

    category: ClassVar[str] = "window"


@EnvConfig.register_subclass("adamanip_door")
@dataclass
class AdaManipDoorEnvConfig(_TurnToOpenEnvConfig):
    """Turn a door's lever, in a hidden direction and by a hidden angle, and pull the leaf open."""

    category: ClassVar[str] = "door"


@EnvConfig.register_subclass("adamanip_lamp")
@dataclass
class AdaManipLampEnvConfig(AdaManipEnvConfig):
    """Switch on a lamp by a button or a knob, which look the same."""

    category: ClassVar[str] = "lamp"

    # Hidden mode for all episodes: 0 push, 1 turn +, 2 turn -; unset to sample it.
    mode: int | None = hidden_value()


@EnvConfig.register_subclass("adamanip")
@dataclass
class AdaManipSuiteEnvConfig(AdaManipEnvConfig):
    """One vector environment per category; ``lerobot-eval`` reports each category and their total.

    The simulators of a category run only during its evaluation, so the suite needs no more memory than one category.
    """

    category: ClassVar[str] = ALL

    # Categories: names separated by commas, or all.
    categories: str = ALL

    def chosen(self) -> tuple[str, ...]:
        """Returns the category names; raises `ConfigurationError` for an unknown one."""
        if self.categories == ALL:
            return tuple(CATEGORIES)
        names = tuple(name.strip() for name in str(self.categories).split(",") if name.strip())
        if not names or len(set(names)) != len(names) or not set(names) <= set(CATEGORIES):
            raise ConfigurationError(
                "Unknown categories.",
                got=repr(self.categories),
                allowed=f"{ALL}, or of {', '.join(CATEGORIES)}",
                hint="--env.categories=safe,microwave",
            )
        return names

    def _groups(self) -> dict[str, dict[str, Any]]:
        """Returns name -> options of each category; a seed gives another scene in each."""
        return {name: {"category": name, "seed_offset": category_offset(name)} for name in self.chosen()}
