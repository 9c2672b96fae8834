"""Base configuration of the policies: clouds and tool poses in, poses out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, ClassVar

import draccus
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.optim.optimizers import AdamWConfig, OptimizerConfig
from torch.nn import Parameter

from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.control import KEYFRAME
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.schema import ACTION, ACTION_DIM, POINT_CLOUD, POSE_NAMES, STATE
from lerobot_adamanip.hardware.features import names_of
from lerobot_adamanip.util.errors import ConfigurationError, require_types, shown_by_parsers
from lerobot_policy_adamanip.common.threads import limit_threads_to_quota, stop_spinning_if_busy

MIN_MOMENT = 1e-30
"""Adam's moments below it are set to zero: they move no weight, and become denormal numbers."""
FLUSH_STEPS = 100
"""Number of steps between two such flushes."""
FUSED_DEVICES = {"cpu", "cuda"}
"""Device types with a fused AdamW kernel in every supported torch."""
EVENTS, WINDOW, CODE = "events", "window", "code"
MEMORY_KINDS = (EVENTS, WINDOW, CODE)
"""What the memory reads: ``events``: the contact events. ``window``: each of the past key frames. ``code``: each of
them too, but its code learns only to reconstruct them, see `contacts.MotionCode`."""


@OptimizerConfig.register_subclass("fused_adamw")
@dataclass
class FusedAdamWConfig(AdamWConfig):
    """LeRobot's AdamW as one fused kernel: faster, and equal up to rounding."""

    def build(self, params: Iterable[Parameter] | Iterable[dict[str, Any]]) -> torch.optim.AdamW:
        """Returns the optimizer of parameters or parameter groups. On a CPU, see `flush_moments` and `threads` too."""
        groups: list[Any] = list(params)
        values = asdict(self)
        values.pop("grad_clip_norm")
        weights = [weight for group in groups for weight in (group["params"] if isinstance(group, dict) else [group])]
        devices = {weight.device.type for weight in weights}
        optimizer = torch.optim.AdamW(groups, **values, fused=devices <= FUSED_DEVICES)
        if devices == {"cpu"}:
            limit_threads_to_quota()
            for hook in (flush_moments, stop_spinning_if_busy):
                optimizer.register_step_post_hook(hook)
        return optimizer


def flush_moments(optimizer: torch.optim.Optimizer, *_: object) -> None:
    """Sets moments below `MIN_MOMENT` to zero, every `FLUSH_STEPS` steps.

    Moments of gradients that stay zero become denormal in float32 within 2,400 steps, and rounding keeps them there. A
    CPU computes many times slower with denormals.
    """
    for state in optimizer.state.values():
        if int(state["step"]) % FLUSH_STEPS == 0:
            for moment in (state["exp_avg"], state["exp_avg_sq"]):
                moment.copy_(torch.nn.functional.hardshrink(moment, MIN_MOMENT))


@dataclass
class CloudPolicyConfig(PreTrainedConfig):
    """Base configuration. The comment above a field is its help on the command line."""

    FREE_OPTIONS: ClassVar[frozenset[str]] = frozenset(
        {each.name for each in fields(PreTrainedConfig)} - {"n_obs_steps"} | {"action_feature_names"}
    )
    """Options that may differ from a checkpoint's: they change neither what its weights see nor what they mean."""

    # Set automatically: names and shapes of the inputs, from the dataset.
    input_features: dict[str, PolicyFeature] | None = field(default_factory=dict)
    # Set automatically: name and shape of the action, from the dataset.
    output_features: dict[str, PolicyFeature] | None = field(default_factory=dict)
    # Number of points used of each cloud: the first ones, since clouds are in farthest-point order.
    num_points: int = 1024
    # Set automatically: whether state and action are poses, from the dataset's feature names.
    pose_layout: bool | None = None
    # Set automatically: lower corner of the box that crops clouds, from the dataset: x, y, z [m], robot base frame.
    workspace_lower: tuple[float, float, float] = DEFAULT_WORKSPACE.lower
    # Set automatically: upper corner of that box [m].
    workspace_upper: tuple[float, float, float] = DEFAULT_WORKSPACE.upper
    # Set automatically: key of the robot's camera whose depth becomes the cloud, from the dataset.
    depth_camera: str = FRONT
    # Set automatically: the dataset's action names; lerobot-rollout maps them to a robot's.
    action_feature_names: list[str] | None = None
    # Set automatically: steps per second of the training data [Hz]; none for key frames.
    control_fps: int | None = None
    # Licence of the published policy, as named on the Hub.
    license: str | None = "apache-2.0"

    def __post_init__(self) -> None:
        """Checks the options, see `check`."""
        with shown_by_parsers():
            require_types(self)
            self.check()
        super().__post_init__()

    def check(self) -> None:
        """Raises `ConfigurationError` for options that do not fit together."""

    def changed_options(self, trained: CloudPolicyConfig) -> dict[str, tuple[Any, Any]]:
        """Returns options with a value that weights were not trained with: name -> own value, trained value."""
        own, saved = draccus.encode(self), draccus.encode(trained)
        for options in (own, saved):
            options["pose_layout"] = options["pose_layout"] is not False  # see `has_pose_layout`
        names = own.keys() - self.FREE_OPTIONS
        return {name: (own[name], saved[name]) for name in sorted(names) if own[name] != saved[name]}

    @property
    def observation_delta_indices(self) -> list[int] | None:
        """None: LeRobot reads the present row; the policy looks up the others by its ``index``."""
        return None

    @property
    def action_delta_indices(self) -> None:
        """None, as above."""
        return None

    @property
    def reward_delta_indices(self) -> None:
        """None: rewards are not used."""
        return None

    @property
    def control(self) -> str | None:
        """Control of the data and environments, see `contract.control.CONTROLS`; None for any."""
        return KEYFRAME

    @property
    def normalization_mapping(self) -> dict[str, NormalizationMode]:
        """Nothing is normalised: distances between poses and clouds are measured in metres."""
        return dict.fromkeys(("STATE", "ENV", "VISUAL", "ACTION"), NormalizationMode.IDENTITY)

    def set_dataset_feature_metadata(self, features: Mapping[str, Mapping[str, Any]]) -> None:
        """Sets `pose_layout` from a dataset's feature names; LeRobot calls this before training."""
        action, state = (names_of(features.get(key)) for key in (ACTION, STATE))
        if action and state:
            self.pose_layout = action == list(POSE_NAMES) and state[:ACTION_DIM] == list(POSE_NAMES)

    @property
    def has_pose_layout(self) -> bool:
        """Whether action and the first ten state values are poses: judged by name, or by size if there are no names."""
        action, state = self.action_feature, (self.input_features or {}).get(STATE)
        if self.pose_layout is False or action is None or state is None:
            return False
        return tuple(action.shape) == (ACTION_DIM,) and int(state.shape[0]) >= ACTION_DIM

    def keep_inputs(self, *keys: str) -> None:
        """Drops all other inputs, so that a checkpoint runs without cameras. Declares the cloud as ENV, (N, 3).

        LeRobot has no point-cloud type, and as STATE the cloud would be normalised under the state's mode. Raises
        `ConfigurationError` if an input is missing, or clouds have fewer points than ``num_points``.
        """
        inputs: dict[str, PolicyFeature] = dict(self.input_features or {})
        if any(key not in inputs for key in keys):
            raise ConfigurationError(
                f"{self.type} misses an input.",
                got=", ".join(inputs) or "no inputs",
                allowed=f"a dataset with {', '.join(keys)}",
                hint=f"{self._collect}; or adamanip keyframes RECORDING --out DATASET",
            )
        cloud = tuple(inputs[POINT_CLOUD].shape)
        if len(cloud) == 1 and cloud[0] % 3 == 0:
            cloud = (cloud[0] // 3, 3)
        if len(cloud) != 2 or cloud[1] < 3 or cloud[0] < self.num_points:
            raise wrong_number_of_points(cloud, self.num_points, trained=self.pretrained_path is not None)
        outputs: dict[str, PolicyFeature] = self.output_features or {}
        self.input_features = {key: inputs[key] for key in keys}
        self.input_features[POINT_CLOUD] = PolicyFeature(FeatureType.ENV, cloud)
        self.output_features = {key: value for key, value in outputs.items() if key == ACTION}

    def require_poses(self) -> None:
        """Raises `ConfigurationError` unless state and action are poses."""
        if not self.has_pose_layout:
            self.require_action()
            assert self.action_feature is not None
            raise ConfigurationError(
                f"{self.type} needs actions that are tool poses.",
                got=f"action {tuple(self.action_feature.shape)}, named as poses: {self.pose_layout}",
                allowed="the contract's ten pose values, in action and in state",
                hint=f"{self._collect}, or --policy.type=dp3_adaptive --policy.preset=dp3",
            )

    @property
    def _collect(self) -> str:
        """Command that collects data that this policy can use."""
        dense = "" if self.control == KEYFRAME else " --control dense --action ee_pose --state full --cloud"
        return f"adamanip collect DIR --category safe{dense}"

    def require_action(self) -> None:
        """Raises `ConfigurationError` for a dataset without actions."""
        if self.action_feature is None:
            raise ConfigurationError(
                "The dataset has no actions.",
                got="no column `action`",
                allowed="demonstrations",
                hint="adamanip collect DIR --category safe",
            )


def wrong_number_of_points(shape: Sequence[int], num_points: int, *, trained: bool = True) -> ConfigurationError:
    """Returns the error for a cloud shape (N, 3); only an untrained policy can use fewer points."""
    hint = f"clouds of {num_points} points (--env.num_points={num_points}), or a policy trained with fewer"
    if not trained and shape and shape[0] > 0:
        hint = f"--policy.num_points={shape[0]}, or a dataset of adamanip collect --num-points {num_points}"
    return ConfigurationError(
        "Wrong number of points.",
        got=f"clouds of shape {tuple(shape)}",
        allowed=f"at least {num_points} points (the policy's num_points) of at least 3 numbers",
        hint=hint,
    )
