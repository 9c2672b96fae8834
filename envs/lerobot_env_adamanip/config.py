"""LeRobot's environment configurations: ``--env.type=adamanip_safe``. Light: no simulator is imported here."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from lerobot_adamanip.contract.cameras import CAMERAS, image_column
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.contract.schema import (
    ACTION,
    ACTION_DIM,
    DEFAULT_NUM_POINTS,
    EFFORT,
    FPS,
    IMAGE_SIZE,
    MAX_KEY_FRAMES,
    NUM_JOINTS,
    POINT_CLOUD,
    STATE,
    STATE_DIM,
)
from lerobot_adamanip.contract.seeds import category_offset
from lerobot_adamanip.episode.options import EnvironmentOptions, refuse_former_name
from lerobot_adamanip.util.errors import ConfigurationError, shown_by_parsers
from lerobot_env_adamanip.sim.render_device import observes_images

if TYPE_CHECKING:
    from lerobot_env_adamanip.vector import VectorEnv


def hidden_value() -> Any:
    """A field that fixes a hidden value by its name; None leaves it to the draw."""
    return field(default=None, metadata={"hidden": True})


@dataclass
class AdaManipEnvConfig(EnvConfig):
    """Options of every environment; see `lerobot_adamanip.episode.options.EnvironmentOptions`."""

    category: ClassVar[str] = ""

    # The environment's name in LeRobot's logs; the category's if not given.
    task: str | None = None
    # Categories of the suite that are evaluated at once, in threads.
    max_parallel_tasks: int = 1
    # Without effect: these environments are not made by gymnasium.make.
    disable_env_checker: bool = True
    # Key frames per second of a recorded video: one step is one key frame, so this is no speed of control.
    fps: int = FPS
    # Which objects: seen (the paper's count), unseen (the next 20), FIRST:END, or ids separated by commas.
    objects: str = "seen"
    # Use the external assets in this folder (AdaManip's, UniDoorManip's or PartNet-Mobility's), see docs/annotate.md.
    assets: str | None = None
    # Points in observation.point_cloud; a policy that uses fewer takes the first, which are a farthest-point sample.
    num_points: int = DEFAULT_NUM_POINTS
    # Side of the front image [px].
    image_size: int = IMAGE_SIZE
    # Observe the front image: true, false, or left out: where this machine renders. false is fastest without a GPU.
    observe_images: bool | None = None
    # randomized: object, robot and camera pose are drawn. fixed: nominal poses, as upstream has them.
    poses: str = "randomized"
    # Mechanisms as in the paper's text (paper), as in its released code (upstream), or ours (hard); docs/categories.md.
    mechanism_rules: str = "paper"
    # Key frames per episode.
    episode_length: int = MAX_KEY_FRAMES
    # Whose scenes: validation to choose by, test for numbers that are reported, train. They share none.
    split: str = "validation"
    # Where clouds come from: raycast (needs no renderer), or render (ten times slower); the same clouds.
    cloud_source: str = "raycast"
    # What renders: cuda, cpu, or auto, the first of them that renders on this machine.
    render_backend: str = "auto"
    # Lower corner of the box of which clouds keep the points: x, y, z, robot base frame [m].
    workspace_lower: tuple[float, float, float] = DEFAULT_WORKSPACE.lower
    # Upper corner of that box [m].
    workspace_upper: tuple[float, float, float] = DEFAULT_WORKSPACE.upper
    # Append each episode's record (seed, object, hidden state, success, tries) to this file; read by `adamanip report`.
    episode_log: str | None = None
    # Log only episodes of these seeds, first and end: [1000,1005] for --seed=1000 --eval.n_episodes=5. LeRobot runs
    # whole batches and counts the first n_episodes; left out, the log holds the last batch's surplus too.
    logged_seeds: tuple[int, int] | None = None
    # What to call these episodes in the log, for instance the policy.
    run_label: str | None = None
    # The former name of --env.poses; setting it is an error that says so.
    pose_preset: str | None = None
    # The former name of --env.mechanism_rules; setting it is an error that says so.
    mechanism_preset: str | None = None
    # Set by itself: the observations' and the action's shapes.
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    # Set by itself: the names they have in datasets.
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fills features from the options.

        Raises:
            AdaManipError: a value cannot work; at once, not when a training first evaluates.
        """
        with shown_by_parsers():
            refuse_former_name("pose_preset", self.pose_preset)
            if self.mechanism_preset != self.mechanism_rules:  # trainings of version 0.2 have stored it
                refuse_former_name("mechanism_preset", self.mechanism_preset)
            for group in self._groups().values():
                self._options(**group)
        self.task = self.task or self.category
        size = self.image_size
        table: dict[str, tuple[FeatureType, tuple[int, ...], str]] = {
            "action": (FeatureType.ACTION, (ACTION_DIM,), ACTION),
            "agent_pos": (FeatureType.STATE, (STATE_DIM,), STATE),
            "effort": (FeatureType.STATE, (NUM_JOINTS,), EFFORT),
            "point_cloud": (FeatureType.ENV, (3 * self.num_points,), POINT_CLOUD),
        }
        if self.observe_images is not False:
            for name in CAMERAS:
                table[f"pixels/{name}"] = (FeatureType.VISUAL, (size, size, 3), image_column(name))
        self.features = {key: PolicyFeature(kind, shape) for key, (kind, shape, _) in table.items()}
        self.features_map = {key: name for key, (_, _, name) in table.items()}

    @property
    def hidden_overrides(self) -> dict[str, bool | int]:
        """Returns the hidden values that the options fix; the others are drawn."""
        names = [item.name for item in fields(self) if item.metadata.get("hidden")]
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    @property
    def options(self) -> EnvironmentOptions:
        """The environment's options."""
        return self._options(self.category, observe_images=self._observes_images())

    def _options(self, category: str, **others: Any) -> EnvironmentOptions:
        shared = [item.name for item in fields(EnvironmentOptions) if item.name not in ("category", "observe_images")]
        values = {name: getattr(self, name) for name in shared if hasattr(self, name)}
        workspace = Workspace(self.workspace_lower, self.workspace_upper)
        values |= {"category": category, "max_key_frames": self.episode_length, "workspace": workspace}
        return EnvironmentOptions(**{**values, **others})

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `KeyframeEnv`."""
        return {"options": self.options}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, VectorEnv]]:
        """Returns ``{type: {0: vector environment}}``; an ended environment waits until the next rollout."""
        from lerobot_adamanip.evaluation.log import new_run_id
        from lerobot_env_adamanip.vector import make_vector_env

        run_id = new_run_id() if self.episode_log else None  # that all of them share in their log
        common: dict[str, Any] = {"observe_images": self._observes_images(), "run_id": run_id}
        options = {name: self._options(**group, **common) for name, group in self._groups().items()}
        return {name: {0: make_vector_env(each, n_envs, use_async_envs)} for name, each in options.items()}

    def _groups(self) -> dict[str, dict[str, Any]]:
        """Returns name of a vector environment -> its own options."""
        return {self.type: {"category": self.category}}

    def _observes_images(self) -> bool:
        """Returns whether pictures are observed; if not, they are removed from the features."""
        observed = observes_images(self.observe_images)
        if not observed:
            for name in CAMERAS:
                self.features.pop(f"pixels/{name}", None)
        return observed


@dataclass
class _TurnToOpenEnvConfig(AdaManipEnvConfig):
    """What turns one way only and opens then."""

    # Fix the hidden direction for an evaluation: 1, -1, or leave it to the draw.
    direction: int | None = hidden_value()


@EnvConfig.register_subclass("adamanip_bottle")
@dataclass
class AdaManipBottleEnvConfig(_TurnToOpenEnvConfig):
    """Turn a bottle's cap, nobody knows which way and how far, and lift it."""

    category: ClassVar[str] = "bottle"


@EnvConfig.register_subclass("adamanip_pen")
@dataclass
class AdaManipPenEnvConfig(_TurnToOpenEnvConfig):
    """Turn a pen's cap, nobody knows which way and how far, and lift it."""

    category: ClassVar[str] = "pen"


@EnvConfig.register_subclass("adamanip_pressure_cooker")
@dataclass
class AdaManipPressureCookerEnvConfig(_TurnToOpenEnvConfig):
    """Turn a pressure cooker's lid by its handle, nobody knows which way and how far, and lift it."""

    category: ClassVar[str] = "pressure_cooker"


@EnvConfig.register_subclass("adamanip_coffee_maker")
@dataclass
class AdaManipCoffeeMakerEnvConfig(_TurnToOpenEnvConfig):
    """Turn a portafilter by its handle, nobody knows which way and how far, and lower it."""

    category: ClassVar[str] = "coffee_maker"


@EnvConfig.register_subclass("adamanip_safe")
@dataclass
class AdaManipSafeEnvConfig(AdaManipEnvConfig):
    """Open a safe that may be locked, by a knob that turns either way."""

    category: ClassVar[str] = "safe"

    # Fix the hidden lock for an evaluation of one half: true, false, or leave it to the draw.
    locked: bool | None = hidden_value()


@EnvConfig.register_subclass("adamanip_microwave")
@dataclass
class AdaManipMicrowaveEnvConfig(AdaManipEnvConfig):
    """Open a microwave that may be locked, by a button that releases its door."""

    category: ClassVar[str] = "microwave"

    # Fix the hidden lock for an evaluation of one half: true, false, or leave it to the draw.
    locked: bool | None = hidden_value()


@EnvConfig.register_subclass("adamanip_window")
@dataclass
class AdaManipWindowEnvConfig(_TurnToOpenEnvConfig):
    """Turn a window's handle, nobody knows which way and how far, and pull the sash open."""

    category: ClassVar[str] = "window"


@EnvConfig.register_subclass("adamanip_door")
@dataclass
class AdaManipDoorEnvConfig(_TurnToOpenEnvConfig):
    """Turn a door's lever, nobody knows which way and how far, and pull the leaf open."""

    category: ClassVar[str] = "door"


@EnvConfig.register_subclass("adamanip_lamp")
@dataclass
class AdaManipLampEnvConfig(AdaManipEnvConfig):
    """Switch on a lamp by a button, or by a knob that looks the same."""

    category: ClassVar[str] = "lamp"

    # Fix the hidden mode for an evaluation: 0 push, 1 turn +, 2 turn -, or leave it to the draw.
    mode: int | None = hidden_value()


@EnvConfig.register_subclass("adamanip")
@dataclass
class AdaManipSuiteEnvConfig(AdaManipEnvConfig):
    """One vector environment per category; ``lerobot-eval`` reports each, and all together.

    A category's simulators start when its turn comes and end after it, so the suite needs no more memory than one.
    """

    category: ClassVar[str] = ALL

    # Which categories: names separated by commas, or all.
    categories: str = ALL

    def chosen(self) -> tuple[str, ...]:
        """Returns the names of the categories; raises `ConfigurationError` for one that there is not."""
        if self.categories == ALL:
            return tuple(CATEGORIES)
        names = tuple(name.strip() for name in self.categories.split(",") if name.strip())
        if not names or len(set(names)) != len(names) or not set(names) <= set(CATEGORIES):
            raise ConfigurationError(
                "Unknown categories.",
                got=repr(self.categories),
                allowed=f"{ALL}, or of {', '.join(CATEGORIES)}",
                hint="--env.categories=safe,microwave",
            )
        return names

    def _groups(self) -> dict[str, dict[str, Any]]:
        """One seed is another scene in each category."""
        return {name: {"category": name, "seed_offset": category_offset(name)} for name in self.chosen()}
