"""Processors of ``dp3_adaptive``: LeRobot's steps, a rigid augmentation, instructions, and orthonormal rotations."""

from __future__ import annotations

import functools
import hashlib
import itertools
import re
from dataclasses import asdict, dataclass
from typing import Any, cast

import torch
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import (
    ProcessorStep,
    ProcessorStepRegistry,
    make_default_policy_processor_steps,
    make_policy_processor_pipelines,
)
from torch import Tensor

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.depth_to_cloud_step import DepthToCloudStep, Pipelines, SameFeaturesStep
from lerobot_policy_adamanip.common.tool_frame import mirrored_poses
from lerobot_policy_adamanip.common.torch_rotations import orthonormal_6d
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig

INSTRUCTION = "observation.instruction"
INSTRUCTION_DIM = 64
SCENE_MOTION = "scene_motion"
"""Key of an augmented batch's `SceneMotion`, which also moves history and labels."""


@dataclass(frozen=True)
class SceneMotion:
    """Random motion of a batch's scenes: mirrored, turned about a vertical, then shifted.

    Attributes:
        mirrored: (B,) bool, whether mirrored left to right; None if no scene is.
        rotation: (B, 3, 3).
        shift: (B, 3) [m].
        center: (x, y, z) [m] of the vertical, robot base frame.
        bounds: translation, yaw and mirror of the `RigidAugmentationStep` that drew it.
    """

    mirrored: Tensor | None
    rotation: Tensor
    shift: Tensor
    center: tuple[float, float, float]
    bounds: tuple[float, float, float]

    def points(self, points: Tensor) -> Tensor:
        """Returns moved points (B, ..., 3+) [m]; values after the first three stay."""
        if self.mirrored is not None:
            other_side = torch.cat([points[..., :1], -points[..., 1:2], points[..., 2:]], dim=-1)
            points = self._where_mirrored(other_side, points)
        return self._turned(points)

    def poses(self, poses: Tensor) -> Tensor:
        """Returns moved poses (B, ..., 10+); values after the first ten stay."""
        if self.mirrored is not None:
            other_side = torch.cat(
                [mirrored_poses(poses[..., : schema.ACTION_DIM]), poses[..., schema.ACTION_DIM :]], dim=-1
            )
            poses = self._where_mirrored(other_side, poses)
        position = self._turned(poses[..., schema.POSITION_DIMS])
        # Rotation 6D is the matrix' first two rows; a turn about z mixes only these.
        rows = poses[..., schema.ROTATION_DIMS].reshape(*poses.shape[:-1], 2, 3)
        turn = self.rotation[:, :2, :2].to(poses.dtype).reshape(len(poses), *(1,) * (poses.dim() - 2), 2, 2)
        return torch.cat([position, (turn @ rows).flatten(-2), poses[..., schema.GRIPPER_DIM :]], dim=-1)

    def _where_mirrored(self, changed: Tensor, plain: Tensor) -> Tensor:
        assert self.mirrored is not None
        return torch.where(self.mirrored.reshape(-1, *(1,) * (plain.dim() - 1)), changed, plain)

    def _turned(self, points: Tensor) -> Tensor:
        center = torch.as_tensor(self.center, dtype=points.dtype, device=points.device)
        flat, turn = points[..., :3].reshape(len(points), -1, 3), self.rotation.transpose(1, 2).to(points.dtype)
        turned = (flat - center) @ turn + center + self.shift[:, None].to(points.dtype)
        return torch.cat([turned.reshape(*points.shape[:-1], 3), points[..., 3:]], dim=-1)


@ProcessorStepRegistry.register("adamanip_rigid_augmentation")
@dataclass
class RigidAugmentationStep(SameFeaturesStep):
    """Moves the whole scene of each training sample: cloud, tool pose and action, in metres. Joint positions stay.

    Each sample has its own draw. The batch keeps it under `SCENE_MOTION` for the columns that the policy looks up.

    Attributes:
        translation: bound of a uniform shift along each axis [m].
        yaw: bound of a uniform turn about the vertical through ``center`` [rad].
        center: (x, y, z) [m], robot base frame.
        mirror: share of mirrored samples.
    """

    translation: float = 0.0
    yaw: float = 0.0
    center: tuple[float, float, float] = (0.55, 0.0, 0.0)
    mirror: float = 0.0

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with a moved scene; without actions, the transition unchanged."""
        actions = transition.get(TransitionKey.ACTION)
        observation = transition.get(TransitionKey.OBSERVATION)
        still = self.translation == self.yaw == self.mirror == 0
        if not isinstance(actions, Tensor) or observation is None or still:
            return transition
        if observation[schema.POINT_CLOUD].dim() == observation[schema.STATE].dim():
            observation = {**observation, schema.POINT_CLOUD: as_points(observation[schema.POINT_CLOUD])}
        motion = self._draw(len(actions), actions.device)
        moved = {
            **observation,
            schema.POINT_CLOUD: motion.points(observation[schema.POINT_CLOUD]),
            schema.STATE: motion.poses(observation[schema.STATE]),
        }
        extra = {**(transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}), SCENE_MOTION: motion}
        changed = {
            **transition,
            TransitionKey.OBSERVATION: moved,
            TransitionKey.ACTION: motion.poses(actions),
            TransitionKey.COMPLEMENTARY_DATA: extra,
        }
        return cast(EnvTransition, changed)

    def _draw(self, batch: int, device: torch.device) -> SceneMotion:
        mirrored = torch.rand(batch, device=device) < self.mirror if self.mirror else None
        rotation = _about_z((2 * torch.rand(batch, device=device) - 1) * self.yaw)
        shift = (2 * torch.rand(batch, 3, device=device) - 1) * self.translation
        return SceneMotion(mirrored, rotation, shift, self.center, (self.translation, self.yaw, self.mirror))

    def get_config(self) -> dict[str, Any]:
        """Returns the options, JSON-able."""
        return {**asdict(self), "center": list(self.center)}


@ProcessorStepRegistry.register("adamanip_orthonormalise")
@dataclass
class OrthonormaliseStep(SameFeaturesStep):
    """Orthonormalises the rotation 6D of an action (..., 10), by Gram-Schmidt, and clips the gripper to [0, 1]."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with the changed action; unchanged if the action is not a pose."""
        action = transition.get(TransitionKey.ACTION)
        if not isinstance(action, Tensor) or action.shape[-1] != schema.ACTION_DIM:
            return transition
        rotation, gripper = (
            orthonormal_6d(action[..., schema.ROTATION_DIMS]),
            action[..., schema.GRIPPER_DIM :].clamp(0, 1),
        )
        pose = torch.cat([action[..., schema.POSITION_DIMS], rotation, gripper], dim=-1)
        return cast(EnvTransition, {**transition, TransitionKey.ACTION: pose})


def instruction_dim(config: DP3AdaptiveConfig) -> int:
    """Returns the length of the instruction vector; 0 for a policy that does not use instructions."""
    return INSTRUCTION_DIM if config.use_instruction else 0


@functools.cache
def instruction_vector(text: str) -> Tensor:
    """Returns a unit vector (64,) by feature hashing (Weinberger et al. 2009) of words and pairs of words."""
    words = re.findall(r"\w+", text.lower())
    vector = torch.zeros(INSTRUCTION_DIM)
    for token in (*words, *(f"{one} {other}" for one, other in itertools.pairwise(words))):
        number = int.from_bytes(hashlib.blake2b(token.encode(), digest_size=8).digest(), "big")
        vector[number % INSTRUCTION_DIM] += 1.0 if number >> 63 else -1.0
    unit: Tensor = vector / vector.norm().clamp(min=1e-6)
    return unit


@ProcessorStepRegistry.register("adamanip_instruction")
@dataclass
class InstructionStep(SameFeaturesStep):
    """Adds the instruction as `instruction_vector` to the observation, (B, 64)."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with the instruction; raises `ConfigurationError` if there is none."""
        task = (transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}).get("task")
        texts = [task] if isinstance(task, str) else list(task or ())
        if not texts or not all(isinstance(text, str) for text in texts):
            raise ConfigurationError(
                "This policy needs an instruction.",
                got=f"task {task!r}",
                allowed="an instruction for each observation of the batch",
                hint="a batch with a list of texts under `task`, as LeRobot's datasets and lerobot-eval give it",
            )
        vectors = torch.stack([instruction_vector(text) for text in texts])
        observation = {**(transition.get(TransitionKey.OBSERVATION) or {}), INSTRUCTION: vectors}
        return cast(EnvTransition, {**transition, TransitionKey.OBSERVATION: observation})


def _about_z(angle: Tensor) -> Tensor:
    """Returns rotations (B, 3, 3) about z by angles (B,) [rad]."""
    cos, sin, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    rows = [torch.stack(row, dim=-1) for row in ((cos, -sin, zero), (sin, cos, zero), (zero, zero, one))]
    return torch.stack(rows, dim=-2)


def make_dp3_adaptive_pre_post_processors(
    config: DP3AdaptiveConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> Pipelines:
    """Returns the pre- and the postprocessor; LeRobot finds this function by its name.

    Adds to LeRobot's defaults: clouds from depth, augmentation and orthonormalisation of poses, and instructions.
    Rotation and gripper of poses are not scaled, whatever their range in the dataset.
    """
    stats: Any = dataset_stats  # arrays, though LeRobot annotates tensors
    if stats and config.has_pose_layout:
        stats = schema.fix_pose_statistics(stats)
    steps = make_default_policy_processor_steps(config, stats)
    inputs: list[ProcessorStep] = [steps.rename_observations, steps.add_batch_dim, DepthToCloudStep.of(config)]
    inputs += [InstructionStep(), steps.to_device] if config.use_instruction else [steps.to_device]
    outputs: list[ProcessorStep] = [steps.unnormalize]
    if config.has_pose_layout:
        moved = {name: getattr(config, f"augmentation_{name}") for name in ("translation", "yaw", "center", "mirror")}
        inputs.append(RigidAugmentationStep(**{name: value for name, value in moved.items() if value is not None}))
        outputs.append(OrthonormaliseStep())
    return cast(Pipelines, make_policy_processor_pipelines([*inputs, steps.normalize], [*outputs, steps.to_cpu]))
