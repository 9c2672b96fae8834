"""Pre- and post-processing of ``dp3_adaptive``: LeRobot's steps, a rigid augmentation, and rotations made whole again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from lerobot.configs.types import PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import (
    PolicyAction,
    PolicyProcessorPipeline,
    ProcessorStep,
    ProcessorStepRegistry,
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)
from torch import Tensor

from lerobot_adamanip.schema import ACTION_DIM, POINT_CLOUD, STATE
from lerobot_policy_adamanip.configuration_dp3_adaptive import DP3AdaptiveConfig

Features = dict[PipelineFeatureType, dict[str, PolicyFeature]]


@ProcessorStepRegistry.register("adamanip_rigid_augmentation")
@dataclass
class RigidAugmentationStep(ProcessorStep):
    """Moves a sample's whole scene: cloud, tool pose, history and labels alike. Joint positions stay as they are.

    Acts only where actions come along, which is in training, and before normalisation, in metres.

    Attributes:
        translation: uniform within +- this along each axis [m].
        yaw: uniform within +- this about the vertical through ``center`` [rad].
        center: [m], robot base frame.
    """

    translation: float = 0.0
    yaw: float = 0.0
    center: tuple[float, float, float] = (0.6, 0.0, 0.7)

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with moved copies; the one given stays as it is."""
        actions = transition.get(TransitionKey.ACTION)
        observation = transition.get(TransitionKey.OBSERVATION)
        if not isinstance(actions, Tensor) or observation is None or (self.translation == 0 and self.yaw == 0):
            return transition
        batch, device = len(actions), actions.device
        angle = (2 * torch.rand(batch, device=device) - 1) * self.yaw
        shift = (2 * torch.rand(batch, 3, device=device) - 1) * self.translation
        rotation = _about_z(angle)
        moved = dict(observation)
        moved[POINT_CLOUD] = self._points(observation[POINT_CLOUD], rotation, shift)
        moved[STATE] = self._poses(observation[STATE], rotation, shift)
        return {
            **transition,
            TransitionKey.OBSERVATION: moved,
            TransitionKey.ACTION: self._poses(actions, rotation, shift),
        }  # type: ignore[misc,typeddict-item]

    def _points(self, points: Tensor, rotation: Tensor, shift: Tensor) -> Tensor:
        """(B, ..., 3), (B, 3, 3), (B, 3) -> (B, ..., 3)."""
        center = torch.as_tensor(self.center, dtype=points.dtype, device=points.device)
        flat = points.flatten(1, -2) if points.dim() > 2 else points[:, None]
        turned = (flat - center) @ rotation.transpose(1, 2).to(points.dtype) + center + shift[:, None].to(points.dtype)
        return turned.reshape(points.shape)

    def _poses(self, poses: Tensor, rotation: Tensor, shift: Tensor) -> Tensor:
        """(B, ..., D) with position and rotation 6D first."""
        position = self._points(poses[..., :3], rotation, shift)
        # Rotation 6D holds the matrix' first two rows; a turn about z mixes just these two.
        rows = poses[..., 3:9].unflatten(-1, (2, 3))
        turn = rotation[:, :2, :2].to(poses.dtype).reshape(len(poses), *(1,) * (poses.dim() - 2), 2, 2)
        return torch.cat([position, (turn @ rows).flatten(-2), poses[..., 9:]], dim=-1)

    def get_config(self) -> dict[str, Any]:
        """JSON-able options."""
        return {"translation": self.translation, "yaw": self.yaw, "center": list(self.center)}

    def transform_features(self, features: Features) -> Features:
        """Shapes stay."""
        return features


@ProcessorStepRegistry.register("adamanip_orthonormalise")
@dataclass
class OrthonormaliseStep(ProcessorStep):
    """Makes the rotation 6D of an action (B, 10) a rotation again (Gram-Schmidt), and clips the gripper to [0, 1]."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Acts on the action alone."""
        action = transition.get(TransitionKey.ACTION)
        if not isinstance(action, Tensor) or action.shape[-1] != ACTION_DIM:
            return transition
        first = torch.nn.functional.normalize(action[..., 3:6], dim=-1)
        second = action[..., 6:9] - (first * action[..., 6:9]).sum(-1, keepdim=True) * first
        second = torch.nn.functional.normalize(second, dim=-1)
        whole = torch.cat([action[..., :3], first, second, action[..., 9:].clamp(0, 1)], dim=-1)
        return {**transition, TransitionKey.ACTION: whole}  # type: ignore[misc,typeddict-item]

    def transform_features(self, features: Features) -> Features:
        """Shapes stay."""
        return features


def _about_z(angle: Tensor) -> Tensor:
    """(B,) [rad] -> (B, 3, 3)."""
    cos, sin, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    rows = [torch.stack(row, dim=-1) for row in ((cos, -sin, zero), (sin, cos, zero), (zero, zero, one))]
    return torch.stack(rows, dim=-2)


def make_dp3_adaptive_pre_post_processors(
    config: DP3AdaptiveConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]:
    """Returns the pipelines around the policy. Their steps' names are part of the checkpoint."""
    steps = make_default_policy_processor_steps(config, dataset_stats)
    inputs: list[ProcessorStep] = [steps.rename_observations, steps.add_batch_dim, steps.to_device]
    outputs: list[ProcessorStep] = [steps.unnormalize]
    if config.has_pose_layout:
        inputs.append(RigidAugmentationStep(config.augmentation_translation or 0.0, config.augmentation_yaw or 0.0))
        outputs.append(OrthonormaliseStep())
    return make_policy_processor_pipelines([*inputs, steps.normalize], [*outputs, steps.to_cpu])
