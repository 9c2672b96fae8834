"""What every policy here asks of its data: a cloud, a state and actions as the contract has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.processor import PolicyAction, PolicyProcessorPipeline
from torch import Tensor

from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import ACTION, ACTION_DIM, POINT_CLOUD, POSE_NAMES, STATE
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.trained_on import log_training_objects

Pipelines = tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]
"""What comes before and behind a policy, as LeRobot calls it."""


def keep_inputs(config: PreTrainedConfig, wanted: Sequence[str], num_points: int) -> None:
    """Leaves a configuration the inputs ``wanted`` and the action; the cloud becomes ENV, which is left as it is.

    LeRobot has no point-cloud type: as STATE it would be normalised under the state's mode. Its shape becomes (N, 3),
    also where a dataset has a row of 3 N numbers. What a policy does not look at, images above all, is dropped, so that
    a checkpoint evaluates wherever clouds are.

    Args:
        config: as LeRobot has filled it in from a dataset; changed in place.
        wanted: keys of the inputs, the cloud among them.
        num_points: that the policy uses of each cloud.

    Raises:
        ConfigurationError: an input is missing, or clouds have fewer points.
    """
    inputs: dict[str, PolicyFeature] = dict(config.input_features or {})
    if any(key not in inputs for key in wanted):
        raise ConfigurationError(
            f"{config.type} misses an input.",
            got=", ".join(inputs) or "no inputs",
            allowed=f"a dataset with {', '.join(wanted)}",
            hint="adamanip collect; of a robot's recording, adamanip keyframes RECORDING --out DATASET",
        )
    cloud = tuple(inputs[POINT_CLOUD].shape)
    if len(cloud) == 1 and cloud[0] % 3 == 0:
        cloud = (cloud[0] // 3, 3)
    if len(cloud) != 2 or cloud[1] < 3 or cloud[0] < num_points:
        raise wrong_number_of_points(cloud, num_points, trained=config.pretrained_path is not None)
    outputs: dict[str, PolicyFeature] = config.output_features or {}
    config.input_features = {key: inputs[key] for key in wanted}
    config.input_features[POINT_CLOUD] = PolicyFeature(FeatureType.ENV, cloud)
    config.output_features = {key: value for key, value in outputs.items() if key == ACTION}


def wrong_number_of_points(shape: tuple[int, ...], num_points: int, *, trained: bool = True) -> ConfigurationError:
    """Returns the error for clouds of a shape (N, 3) that is too small for a policy that uses ``num_points``.

    A policy that is not ``trained`` yet can use fewer points.
    """
    hint = f"clouds of {num_points} points (--env.num_points={num_points}), or a policy trained with fewer"
    if not trained and shape and shape[0] > 0:
        hint = f"--policy.num_points={shape[0]}, or a dataset of adamanip collect --num-points {num_points}"
    return ConfigurationError(
        "Wrong number of points.",
        got=f"clouds of shape {tuple(shape)}",
        allowed=f"at least {num_points} points (the policy's num_points) of at least 3 numbers",
        hint=hint,
    )


def picked_inputs(config: PreTrainedConfig, batch: Mapping[str, Any], num_points: int) -> dict[str, Tensor]:
    """Returns a policy's inputs out of a batch, and of each cloud the first points (..., N, 3); the batch stays.

    Raises:
        ConfigurationError: the batch lacks one, or its clouds have fewer points than ``num_points``.
    """
    wanted = config.input_features
    if any(batch.get(key) is None for key in wanted):
        raise ConfigurationError(
            "The observation lacks what the policy looks at.",
            got=", ".join(key for key in batch if key.startswith("observation")) or "no observation",
            allowed=", ".join(wanted),
            hint="--env.type=adamanip_safe, or another environment with point clouds",
        )
    picked = {key: batch[key] for key in wanted}
    cloud = picked[POINT_CLOUD]
    if cloud.shape[-1] != wanted[POINT_CLOUD].shape[-1]:
        cloud = as_points(cloud)
    if cloud.shape[-2] < num_points:
        raise wrong_number_of_points(tuple(cloud.shape[-2:]), num_points)
    picked[POINT_CLOUD] = cloud[..., :num_points, :3]
    return picked


def observed(config: PreTrainedConfig, batch: Mapping[str, Any], num_points: int) -> tuple[Tensor, Tensor]:
    """Returns the clouds (B, N, 3) [m] and the tool poses (B, 10) of one observation; see `picked_inputs`.

    LeRobot adds a missing batch dimension to states, but not to clouds.
    """
    picked = picked_inputs(config, batch, num_points)
    cloud, pose = picked[POINT_CLOUD], picked[STATE][..., :ACTION_DIM]
    return (cloud[None] if cloud.dim() == 2 else cloud).float(), pose.float()


def names_are_poses(features: Mapping[str, Mapping[str, Any]]) -> bool | None:
    """Returns whether a dataset's actions and its states' start are poses, by their names; None if it has no names."""
    action, state = (_flat_names(features.get(key, {}).get("names")) for key in (ACTION, STATE))
    if not action or not state:
        return None
    return action == list(POSE_NAMES) and state[:ACTION_DIM] == list(POSE_NAMES)


def has_pose_layout(config: PreTrainedConfig, named: bool | None) -> bool:
    """Whether action and the state's start are the contract's ten numbers, so that they can be moved and related.

    Names decide (``named``, see `names_are_poses`); where a dataset has none, sizes do.
    """
    action, state = config.action_feature, (config.input_features or {}).get(STATE)
    if named is False or action is None or state is None:
        return False
    return tuple(action.shape) == (ACTION_DIM,) and int(state.shape[0]) >= ACTION_DIM


def require_action(config: PreTrainedConfig) -> None:
    """Raises `ConfigurationError` for a dataset without actions."""
    if config.action_feature is None:
        raise ConfigurationError(
            "The dataset has no actions.", got="no column `action`", allowed="demonstrations", hint="adamanip collect"
        )


def _flat_names(names: Any) -> list[str]:
    """A feature's names: LeRobot allows a list, a dict of lists, or nothing."""
    if isinstance(names, dict):
        return [name for group in names.values() for name in (group if isinstance(group, list) else [str(group)])]
    return list(names or [])


class LoadsStrictly:
    """Mixed into a policy: a checkpoint that does not fit is an error.

    LeRobot's default would leave what is missing at random values.
    """

    @classmethod
    def _load_as_safetensor(cls, model: Any, model_file: str, map_location: str, strict: bool) -> Any:
        log_training_objects(Path(model_file).parent)
        try:
            return super()._load_as_safetensor(model, model_file, map_location, True)  # type: ignore[misc]
        except RuntimeError as error:
            reasons = [line.strip() for line in str(error).splitlines() if line.strip()]
            raise ConfigurationError(
                f"The checkpoint {Path(model_file).parent} does not fit this policy.",
                got="; ".join(reasons[:3])[:400],
                allowed="weights saved with the same options",
                hint="leave --policy.* options as in its config.json",
            ) from error
