"""Processors of ``dp3_adaptive``: LeRobot's steps, mirrored scenes, instructions, and orthonormal rotations."""

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
from lerobot_policy_adamanip.common.geometry import mirrored_poses, valid_pose
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig

INSTRUCTION = "observation.instruction"
INSTRUCTION_DIM = 64
MIRRORING = "mirroring"
"""Key of an augmented batch's `Mirroring`, which also mirrors history and labels."""


@dataclass(frozen=True)
class Mirroring:
    """Which scenes of a batch are mirrored left to right, (B,) bool, and the ``share`` they were drawn with."""

    mirrored: Tensor
    share: float

    def points(self, points: Tensor) -> Tensor:
        """Returns points (B, ..., 3+) [m], mirrored; values after the first three stay."""
        return self._select(torch.cat([points[..., :1], -points[..., 1:2], points[..., 2:]], dim=-1), points)

    def poses(self, poses: Tensor) -> Tensor:
        """Returns poses (B, ..., 10+), mirrored; values after the first ten stay."""
        mirrored = torch.cat([mirrored_poses(poses[..., : schema.ACTION_DIM]), poses[..., schema.ACTION_DIM :]], dim=-1)
        return self._select(mirrored, poses)

    def _select(self, mirrored: Tensor, plain: Tensor) -> Tensor:
        return torch.where(self.mirrored.reshape(-1, *(1,) * (plain.dim() - 1)), mirrored, plain)


@ProcessorStepRegistry.register("adamanip_mirror")
@dataclass
class MirrorStep(SameFeaturesStep):
    """Mirrors a ``share`` of training samples: cloud, tool pose and action, in metres. Joint positions stay.

    Each sample has its own draw. The batch keeps it under `MIRRORING` for the columns that the policy looks up.
    """

    share: float = 0.0

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with mirrored scenes; without actions, the transition unchanged."""
        actions, observation = transition.get(TransitionKey.ACTION), transition.get(TransitionKey.OBSERVATION)
        if not isinstance(actions, Tensor) or observation is None or self.share == 0.0:
            return transition
        mirroring = Mirroring(torch.rand(len(actions), device=actions.device) < self.share, self.share)
        cloud, state = observation[schema.POINT_CLOUD], observation[schema.STATE]
        cloud = as_points(cloud) if cloud.dim() == state.dim() else cloud
        changed = {
            **transition,
            TransitionKey.OBSERVATION: {
                **observation,
                schema.POINT_CLOUD: mirroring.points(cloud),
                schema.STATE: mirroring.poses(state),
            },
            TransitionKey.ACTION: mirroring.poses(actions),
            TransitionKey.COMPLEMENTARY_DATA: {
                **(transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}),
                MIRRORING: mirroring,
            },
        }
        return cast(EnvTransition, changed)

    def get_config(self) -> dict[str, Any]:
        """Returns the options, JSON-able."""
        return asdict(self)


@ProcessorStepRegistry.register("adamanip_orthonormalise")
@dataclass
class OrthonormaliseStep(SameFeaturesStep):
    """Orthonormalises the rotation 6D of an action (..., 10), by Gram-Schmidt, and clips the gripper to [0, 1]."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with the changed action; unchanged if the action is not a pose."""
        action = transition.get(TransitionKey.ACTION)
        if not isinstance(action, Tensor) or action.shape[-1] != schema.ACTION_DIM:
            return transition
        return cast(EnvTransition, {**transition, TransitionKey.ACTION: valid_pose(action)})


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
        inputs.append(MirrorStep(config.augmentation_mirror))
        outputs.append(OrthonormaliseStep())
    return cast(Pipelines, make_policy_processor_pipelines([*inputs, steps.normalize], [*outputs, steps.to_cpu]))
