"""Pre- and post-processing of ``dp3_adaptive``: LeRobot's steps, a rigid augmentation, and rotations made whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import torch
from lerobot.configs.types import PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import (
    ProcessorStep,
    ProcessorStepRegistry,
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)
from torch import Tensor

from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.pointcloud import as_points
from lerobot_adamanip.schema import (
    ACTION_DIM,
    GRIPPER_DIM,
    POINT_CLOUD,
    POSITION_DIMS,
    ROTATION_DIMS,
    STATE,
    fix_pose_statistics,
)
from lerobot_policy_adamanip.contract import Pipelines
from lerobot_policy_adamanip.depth_step import DepthToCloudStep
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.tasks import INSTRUCTION, instruction_vector
from lerobot_policy_adamanip.rotations import orthonormal_6d
from lerobot_policy_adamanip.tool_frame import mirrored_poses

Features = dict[PipelineFeatureType, dict[str, PolicyFeature]]


@ProcessorStepRegistry.register("adamanip_rigid_augmentation")
@dataclass
class RigidAugmentationStep(ProcessorStep):
    """Moves a sample's whole scene: cloud, tool pose, history and labels alike. Joint positions stay as they are.

    A share of the samples is mirrored first, left for right.

    Acts only where actions come along, which is in training, and before normalisation, in metres. Every sample of a
    batch is moved by a draw of its own, all of its time steps by the same one.

    Attributes:
        translation: uniform within +- this along each axis [m].
        yaw: uniform within +- this about the vertical through ``center`` [rad].
        center: (x, y, z) [m], robot base frame.
        mirror: share of samples that are mirrored.
    """

    translation: float = 0.0
    yaw: float = 0.0
    center: tuple[float, float, float] = (0.55, 0.0, 0.0)
    mirror: float = 0.0

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with moved copies; the one given stays as it is."""
        actions = transition.get(TransitionKey.ACTION)
        observation = transition.get(TransitionKey.OBSERVATION)
        still = self.translation == self.yaw == self.mirror == 0
        if not isinstance(actions, Tensor) or observation is None or still:
            return transition
        batch, device = len(actions), actions.device
        cloud, state = observation[POINT_CLOUD], observation[STATE]
        if cloud.dim() == state.dim():
            observation = {**observation, POINT_CLOUD: as_points(cloud)}
        if self.mirror:
            chosen = torch.rand(batch, device=device) < self.mirror
            observation, actions = _mirrored(observation, actions, chosen)
        rotation = _about_z((2 * torch.rand(batch, device=device) - 1) * self.yaw)
        shift = (2 * torch.rand(batch, 3, device=device) - 1) * self.translation
        moved = {
            **observation,
            POINT_CLOUD: self._points(observation[POINT_CLOUD], rotation, shift),
            STATE: self._poses(observation[STATE], rotation, shift),
        }
        actions = self._poses(actions, rotation, shift)
        changed = {**transition, TransitionKey.OBSERVATION: moved, TransitionKey.ACTION: actions}
        return cast(EnvTransition, changed)

    def _points(self, points: Tensor, rotation: Tensor, shift: Tensor) -> Tensor:
        """(B, ..., 3+), (B, 3, 3), (B, 3) -> moved, numbers after the first three as they were."""
        center = torch.as_tensor(self.center, dtype=points.dtype, device=points.device)
        flat = points[..., :3].reshape(len(points), -1, 3)
        turned = (flat - center) @ rotation.transpose(1, 2).to(points.dtype) + center + shift[:, None].to(points.dtype)
        return torch.cat([turned.reshape(*points.shape[:-1], 3), points[..., 3:]], dim=-1)

    def _poses(self, poses: Tensor, rotation: Tensor, shift: Tensor) -> Tensor:
        """(B, ..., D) with position and rotation 6D first."""
        position = self._points(poses[..., POSITION_DIMS], rotation, shift)
        # Rotation 6D holds the matrix' first two rows; a turn about z mixes just these two.
        rows = poses[..., ROTATION_DIMS].reshape(*poses.shape[:-1], 2, 3)
        turn = rotation[:, :2, :2].to(poses.dtype).reshape(len(poses), *(1,) * (poses.dim() - 2), 2, 2)
        return torch.cat([position, (turn @ rows).flatten(-2), poses[..., GRIPPER_DIM:]], dim=-1)

    def get_config(self) -> dict[str, Any]:
        """JSON-able options."""
        told = {"translation": self.translation, "yaw": self.yaw, "center": list(self.center)}
        return {**told, "mirror": self.mirror}

    def transform_features(self, features: Features) -> Features:
        """Shapes stay."""
        return features


@ProcessorStepRegistry.register("adamanip_orthonormalise")
@dataclass
class OrthonormaliseStep(ProcessorStep):
    """Makes the rotation 6D of an action (..., 10) a rotation again (Gram-Schmidt), and clips the gripper to [0, 1]."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Acts on the action alone, and only if it is a pose."""
        action = transition.get(TransitionKey.ACTION)
        if not isinstance(action, Tensor) or action.shape[-1] != ACTION_DIM:
            return transition
        whole = torch.cat(
            [
                action[..., POSITION_DIMS],
                orthonormal_6d(action[..., ROTATION_DIMS]),
                action[..., GRIPPER_DIM:].clamp(0, 1),
            ],
            dim=-1,
        )
        return cast(EnvTransition, {**transition, TransitionKey.ACTION: whole})

    def transform_features(self, features: Features) -> Features:
        """Shapes stay."""
        return features


@ProcessorStepRegistry.register("adamanip_instruction")
@dataclass
class InstructionStep(ProcessorStep):
    """Adds the instruction as `instruction_vector` to the observation, (B, 64)."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with it; raises `ConfigurationError` if nobody says what is to be done."""
        told = (transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}).get("task")
        texts = [told] if isinstance(told, str) else list(told or ())
        if not texts or not all(isinstance(text, str) for text in texts):
            raise ConfigurationError(
                "This policy is told what to do, and nobody told it.",
                got=f"task {told!r}",
                allowed="an instruction for each observation of the batch",
                hint="a batch with a list of texts under `task`, as LeRobot's datasets and lerobot-eval give it",
            )
        vectors = torch.stack([instruction_vector(text) for text in texts])
        observation = {**(transition.get(TransitionKey.OBSERVATION) or {}), INSTRUCTION: vectors}
        return cast(EnvTransition, {**transition, TransitionKey.OBSERVATION: observation})

    def transform_features(self, features: Features) -> Features:
        """Features of the dataset stay as they are."""
        return features


def _mirrored(observation: dict[str, Any], actions: Tensor, chosen: Tensor) -> tuple[dict[str, Any], Tensor]:
    """Mirrors the samples (B,) that are chosen."""

    def where(changed: Tensor, plain: Tensor) -> Tensor:
        return torch.where(chosen.reshape(-1, *(1,) * (plain.dim() - 1)), changed, plain)

    cloud, state = observation[POINT_CLOUD], observation[STATE]
    other_side = torch.cat([cloud[..., :1], -cloud[..., 1:2], cloud[..., 2:]], dim=-1)
    tool = torch.cat([mirrored_poses(state[..., :ACTION_DIM]), state[..., ACTION_DIM:]], dim=-1)
    seen = {**observation, POINT_CLOUD: where(other_side, cloud), STATE: where(tool, state)}
    return seen, where(mirrored_poses(actions), actions)


def _about_z(angle: Tensor) -> Tensor:
    """(B,) [rad] -> (B, 3, 3)."""
    cos, sin, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    rows = [torch.stack(row, dim=-1) for row in ((cos, -sin, zero), (sin, cos, zero), (zero, zero, one))]
    return torch.stack(rows, dim=-2)


def make_dp3_adaptive_pre_post_processors(
    config: DP3AdaptiveConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> Pipelines:
    """Returns the pipelines around the policy. Their steps' names are part of the checkpoint.

    Clouds are made from depth where a robot delivers pictures. Two more steps join LeRobot's defaults where state and
    action are the contract's poses, and one where the policy is told what to do. Rotation and gripper of such poses
    stay unscaled, whatever their range in the dataset.
    """
    stats: Any = dataset_stats  # arrays, as LeRobot's datasets have them, though its factories announce tensors
    if stats and config.has_pose_layout:
        stats = fix_pose_statistics(stats)
    steps = make_default_policy_processor_steps(config, stats)
    told: list[ProcessorStep] = [InstructionStep()] if config.use_instruction else []
    depth = DepthToCloudStep(config.num_points)
    inputs: list[ProcessorStep] = [steps.rename_observations, steps.add_batch_dim, depth, *told, steps.to_device]
    outputs: list[ProcessorStep] = [steps.unnormalize]
    if config.has_pose_layout:
        moved = (config.augmentation_translation, config.augmentation_yaw, config.augmentation_center)
        inputs.append(RigidAugmentationStep(*moved, config.augmentation_mirror))
        outputs.append(OrthonormaliseStep())
    return cast(Pipelines, make_policy_processor_pipelines([*inputs, steps.normalize], [*outputs, steps.to_cpu]))
