"""LeRobot's environment configurations: ``--env.type=adamanip_safe``. Light: no simulator is imported here."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import gymnasium as gym
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.schema import (
    ACTION,
    ACTION_DIM,
    DEFAULT_NUM_POINTS,
    EFFORT,
    FPS,
    FRONT_IMAGE,
    IMAGE_SIZE,
    MAX_KEY_FRAMES,
    NUM_JOINTS,
    POINT_CLOUD,
    STATE,
    STATE_DIM,
)


def hidden_value() -> Any:
    """A field that fixes a hidden value by its name; None leaves it to the draw."""
    return field(default=None, metadata={"hidden": True})


@dataclass
class AdaManipEnvConfig(EnvConfig):
    """What the environments share. One step is one key frame, so ``fps`` is the speed of videos, not of control."""

    category: ClassVar[str] = ""

    fps: int = FPS
    # Which objects: seen (the paper's count), unseen (the next 20), FIRST:END, or ids separated by commas.
    objects: str = "seen"
    # Use the objects of others in this folder (AdaManip's, UniDoorManip's or PartNet-Mobility's), see docs/annotate.md.
    assets: str | None = None
    # Points in observation.point_cloud; a policy that uses fewer takes the first, which are a farthest-point sample.
    num_points: int = DEFAULT_NUM_POINTS
    # Side of the front image [px].
    image_size: int = IMAGE_SIZE
    # Whether observations hold the front image; policies that look at clouds alone do not need it.
    observe_images: bool = True
    # default: object, robot and camera pose are randomised. paper: fixed.
    pose_preset: str = "default"
    # paper: mechanisms as the paper's text has them. upstream: as its released code has them.
    mechanism_preset: str = "paper"
    # Key frames per episode.
    episode_length: int = MAX_KEY_FRAMES
    # Append each episode's record (seed, object, hidden state, success, tries) to this file; read by `adamanip report`.
    episode_log: str | None = None
    # What to call these episodes in the log, for instance the policy.
    run_label: str | None = None
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fills features from the options."""
        self.task: str | None = self.task or self.category
        size = self.image_size
        table = {
            "action": (FeatureType.ACTION, (ACTION_DIM,), ACTION),
            "agent_pos": (FeatureType.STATE, (STATE_DIM,), STATE),
            "effort": (FeatureType.STATE, (NUM_JOINTS,), EFFORT),
            "point_cloud": (FeatureType.ENV, (self.num_points, 3), POINT_CLOUD),
            "pixels/front": (FeatureType.VISUAL, (size, size, 3), FRONT_IMAGE),
        }
        if not self.observe_images:
            del table["pixels/front"]
        self.features = {key: PolicyFeature(kind, shape) for key, (kind, shape, _) in table.items()}
        self.features_map = {key: name for key, (_, _, name) in table.items()}

    @property
    def hidden_overrides(self) -> dict[str, Any] | None:
        """Returns the hidden values that the options fix; None if all are drawn."""
        names = [item.name for item in fields(self) if item.metadata.get("hidden")]
        fixed = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return fixed or None

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `KeyframeEnv`."""
        return {
            "objects": self.objects,
            "assets": self.assets,
            "num_points": self.num_points,
            "image_size": self.image_size,
            "observe_images": self.observe_images,
            "pose_preset": self.pose_preset,
            "mechanism_preset": self.mechanism_preset,
            "max_key_frames": self.episode_length,
            "hidden_overrides": self.hidden_overrides,
            "episode_log": self.episode_log,
            "run_label": self.run_label,
        }

    def evaluation_kwargs(self) -> dict[str, Any]:
        """Returns `gym_kwargs` with the id that all environments of an evaluation share."""
        from lerobot_adamanip.evaluation.log import new_run_id

        return {**self.gym_kwargs, "run_id": new_run_id() if self.episode_log else None}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv[Any, Any, Any]]]:
        """Returns ``{type: {0: vector environment}}``; an ended environment waits until the next rollout."""
        return {self.type: {0: make_vector_env(self.category, self.evaluation_kwargs(), n_envs, use_async_envs)}}


def make_vector_env(
    category: str, kwargs: dict[str, Any], n_envs: int, use_async_envs: bool
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Returns ``n_envs`` environments of a category as one; an ended one waits until the next rollout."""
    from lerobot_adamanip.lerobot_compat import freeze_after_episode_end, lazy_async_vector_env
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    if n_envs < 1:
        raise ConfigurationError(
            "Wrong number of environments.", got=n_envs, allowed=">= 1", hint="--eval.batch_size=2"
        )
    functions = [lambda: KeyframeEnv(category, **kwargs) for _ in range(n_envs)]
    # More than one simulator in a process would render one after the other; a process each uses every core.
    vector: gym.vector.VectorEnv[Any, Any, Any] = (
        lazy_async_vector_env(functions)
        if use_async_envs and n_envs > 1
        else gym.vector.SyncVectorEnv(
            [freeze_after_episode_end(function) for function in functions],
            autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP,
        )
    )
    return vector


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
