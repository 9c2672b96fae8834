"""Processor step that computes clouds from a robot's depth images at run time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
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

from lerobot_adamanip.contract.cameras import image_column, is_image_column
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace, check_num_points
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, POINT_CLOUD, STATE
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX, FRONT_CAMERA
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.config import CloudPolicyConfig

Pipelines = tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]
"""Pre- and postprocessor of a policy."""


class SameFeaturesStep(ProcessorStep):
    """Processor step that does not change a dataset's features."""

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Returns the features unchanged."""
        return features


@ProcessorStepRegistry.register("adamanip_depth_to_cloud")
@dataclass
class DepthToCloudStep(SameFeaturesStep):
    """Computes ``observation.point_cloud`` from a camera's depth, and drops the images.

    Observations with a cloud, or without depth, stay unchanged. The calibration comes from the file ``calibration`` or,
    without one, from the connected robot, since a checkpoint does not contain the camera's pose.

    Attributes:
        num_points: number of points of the cloud.
        lower, upper: corners of the workspace, robot base frame [m].
        camera: key of the camera in the robot's configuration.
        calibration: path of a calibration file; None for the connected robot's.
        control_fps: rate of the policy [Hz]; None for key frames.
    """

    num_points: int = DEFAULT_NUM_POINTS
    lower: tuple[float, float, float] = DEFAULT_WORKSPACE.lower
    upper: tuple[float, float, float] = DEFAULT_WORKSPACE.upper
    camera: str = FRONT_CAMERA
    calibration: str | None = None
    control_fps: int | None = None
    _read: CameraCalibration | None = field(default=None, init=False, repr=False)

    @classmethod
    def of(cls, config: CloudPolicyConfig) -> Self:
        """Returns the step that makes clouds like those that a policy was trained on."""
        workspace = config.workspace_lower, config.workspace_upper
        return cls(config.num_points, *workspace, config.depth_camera, control_fps=config.control_fps)

    def __post_init__(self) -> None:
        """Raises `ConfigurationError` for an invalid number of points."""
        check_num_points(self.num_points)

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with the cloud (B, N, 3), or the transition unchanged."""
        observation = transition.get(TransitionKey.OBSERVATION)
        key = image_column(self.camera) + DEPTH_SUFFIX
        if observation is None or observation.get(POINT_CLOUD) is not None or observation.get(key) is None:
            return transition
        self._check_execution()
        picture = observation[key]
        cloud = self._clouds(picture, observation.get(STATE))
        kept = {name: value for name, value in observation.items() if not is_image_column(name)}
        kept[POINT_CLOUD] = cloud.to(picture.device)
        return cast(EnvTransition, {**transition, TransitionKey.OBSERVATION: kept})

    def _check_execution(self) -> None:
        """Raises `ConfigurationError` if the connected robot executes a policy of the other control."""
        from lerobot_adamanip.hardware.adamanip_franka.execution_check import require_execution
        from lerobot_adamanip.hardware.arm import Execution
        from lerobot_adamanip.hardware.robot_registry import ROBOTS

        session = ROBOTS.find()
        needed = Execution.KEYFRAME if self.control_fps is None else Execution.STREAM
        require_execution(needed, None if session is None else session.execution, "this policy")

    def _clouds(self, picture: Tensor, state: Tensor | None) -> Tensor:
        """Converts depth (..., H, W, 1) or (..., 1, H, W) [mm] to (..., N, 3) [m]; adds a missing batch dimension."""
        from lerobot_adamanip.episode.memory import hand_of  # imports scipy
        from lerobot_adamanip.hardware.depth_cloud import depth_cloud

        depth = _without_channel(picture.detach().cpu().numpy())
        leading = depth.shape[:-2]
        poses: list[np.ndarray[Any, np.dtype[np.float64]] | None] = [None] * int(np.prod(leading))
        if state is not None and state.numel() // state.shape[-1] == len(poses):
            rows = state.detach().cpu().double().numpy().reshape(len(poses), -1)
            poses = [hand_of(row).tcp_in_base for row in rows]
        calibration, workspace = self._calibration(), Workspace(_corner(self.lower), _corner(self.upper))
        clouds = [
            depth_cloud(each, calibration, self.num_points, workspace, pose)
            for each, pose in zip(depth.reshape(-1, *depth.shape[-2:]), poses, strict=True)
        ]
        return torch.from_numpy(np.stack(clouds).reshape(*(leading or (1,)), self.num_points, 3))

    def _calibration(self) -> CameraCalibration:
        from lerobot_adamanip.hardware.camera_frames import read_calibrations
        from lerobot_adamanip.hardware.robot_registry import ROBOTS

        if self.calibration is not None:
            if self._read is None:
                calibrations = read_calibrations(Path(self.calibration))
                if self.camera not in calibrations:
                    raise self._unknown(f"{self.calibration} knows {', '.join(calibrations) or 'no camera'}")
                self._read = calibrations[self.camera]
            return self._read
        session = ROBOTS.find()
        if session is None:
            raise self._unknown("no file, and not one connected robot to ask")
        calibration: CameraCalibration | None = session.calibrations.get(self.camera)
        if calibration is None:
            known = ", ".join(session.calibrations) or "none"
            raise self._unknown(f"no file, and a robot that knows the calibration of these cameras: {known}")
        return calibration

    def _unknown(self, got: str) -> ConfigurationError:
        return ConfigurationError(
            f"The calibration of camera {self.camera} is missing; its depth cannot become a cloud.",
            got=got,
            allowed=f"a calibration file of the robot with camera {self.camera}, or one named in the checkpoint's "
            "policy_preprocessor.json, step adamanip_depth_to_cloud, field calibration",
            hint="adamanip calibrate views --record robot.json --out FILE",
        )

    def get_config(self) -> dict[str, Any]:
        """Returns the options, JSON-able."""
        names = ("num_points", "lower", "upper", "camera", "calibration", "control_fps")
        return {**{name: getattr(self, name) for name in names}, "lower": list(self.lower), "upper": list(self.upper)}


def _corner(numbers: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z


def _without_channel(depth: np.ndarray[Any, np.dtype[Any]]) -> np.ndarray[Any, np.dtype[Any]]:
    """(..., H, W, 1) or (..., 1, H, W), uint16 or float -> (..., H, W)."""
    for axis in (-1, -3):
        if depth.ndim >= 3 and depth.shape[axis] == 1 and (depth.dtype == np.uint16 or depth.dtype.kind == "f"):
            return depth.squeeze(axis)
    raise ConfigurationError(
        "The picture is not depth.",
        got=f"{depth.dtype} of shape {depth.shape}",
        allowed="uint16 or float32 [mm], of shape (H, W, 1) or (1, H, W), with a batch or without",
        hint="a camera with use_depth=true",
    )


def make_pipelines_with_depth(
    config: CloudPolicyConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> Pipelines:
    """Returns LeRobot's default pre- and postprocessor, with clouds from depth."""
    steps = make_default_policy_processor_steps(config, dataset_stats)
    inputs = [
        steps.rename_observations,
        steps.add_batch_dim,
        DepthToCloudStep.of(config),
        steps.to_device,
        steps.normalize,
    ]
    return cast(Pipelines, make_policy_processor_pipelines(inputs, [steps.unnormalize, steps.to_cpu]))
