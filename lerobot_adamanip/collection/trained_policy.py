"""Runner of a trained LeRobot policy in a `KeyframeEnvironment`, outside of `lerobot-eval`, and checks of its files."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import is_image_column
from lerobot_adamanip.contract.observation import Observation, observation_columns
from lerobot_adamanip.contract.schema import ACTION
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    import torch  # imported where it is used: `adamanip push` checks pipelines without it

Action = NDArray[np.float32]
_ACTING = ("config.json", "model.safetensors", "policy_*processor*")
"""Checkpoint files that affect its actions."""
PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")


def pipeline_steps(folder: Path) -> list[dict[str, Any]]:
    """Returns the steps of both pipelines of a checkpoint.

    Raises:
        ValueError: a file is damaged, or a step is not a registered one. LeRobot 0.6.1 imports and calls any function
            that a step names as ``class`` (https://github.com/huggingface/lerobot/issues/4219).
        OSError: a file is missing.
    """
    steps = [step for name in PIPELINES for step in json_fields.read(folder / name)["steps"]]
    for step in steps:
        if not isinstance(step.get("registry_name"), str):
            named = str(step.get("class"))[:80]
            raise ValueError(f"a step of a pipeline has no registry_name, but names the class {named!r} to be called")
    return steps


def policy_hash(path: Path) -> str:
    """Returns a hash of a checkpoint's weights, configuration and processors, but not of its training or its folder.

    Raises:
        ConfigurationError: the checkpoint does not exist.
    """
    digest = hashlib.sha256()
    for name in ("config.json", "model.safetensors"):
        if not (path / name).is_file():
            raise ConfigurationError(
                "No policy is there.",
                got=f"{path}, without {name}",
                allowed="the folder pretrained_model of a checkpoint",
                hint="--policy outputs/.../checkpoints/last/pretrained_model",
            )
    names = {file.name for pattern in _ACTING for file in path.glob(pattern)}
    for name in sorted(names):
        content = (path / name).read_bytes()
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:32]


def register_policies() -> None:
    """Registers the policies of LeRobot and of installed plugins."""
    import lerobot.policies  # noqa: F401
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()


class TrainedPolicy:
    """Acts as in `lerobot-eval`: same policy, same processors, one environment.

    Args:
        path: folder ``pretrained_model`` of a checkpoint.
        device: PyTorch device.

    Raises:
        ConfigurationError: a pipeline is missing or damaged, or has steps that are not registered.
    """

    def __init__(self, path: Path, device: str = "cpu") -> None:
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors

        register_policies()
        try:
            pipeline_steps(path)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise ConfigurationError(
                "The pipelines of this checkpoint cannot be used.",
                got=f"{path}: {error}"[:400],
                allowed="both pipelines, with steps that LeRobot or an installed plugin has registered",
                hint="save the checkpoint again with lerobot-train",
            ) from error
        config = PreTrainedConfig.from_pretrained(str(path))
        config.device, config.pretrained_path = device, path
        if hasattr(config, "memory_episodes"):
            config.memory_episodes = 1  # else an episode would depend on those before it in its worker
        self._policy: Any = get_policy_class(config.type).from_pretrained(str(path), config=config)
        self._policy.to(device).eval()
        overrides = {"device_processor": {"device": device}}
        self._before, self._after = make_pre_post_processors(
            config, pretrained_path=str(path), preprocessor_overrides=overrides
        )

    def reset(self, seed: int) -> None:
        """Starts an episode; its random numbers follow from the seed."""
        import torch

        torch.manual_seed(seed % 2**63)
        self._policy.reset()
        for pipeline in (self._before, self._after):
            pipeline.reset()

    def act(self, observation: Observation, instruction: str) -> Action:
        """Returns the action (A,) and adds it to the policy's history, if it has one."""
        import torch

        with torch.inference_mode():
            action = self._after(self._policy.select_action(self._before(_batch(observation, instruction))))
        return np.asarray(action.squeeze(0).cpu(), np.float32)

    def executed(self, action: Action) -> None:
        """Replaces the latest action in the policy's history, if it has one, and drops the rest of its chunk."""
        import torch

        if hasattr(self._policy, "replace_latest"):
            self._policy.replace_latest(self._normalized(torch.from_numpy(action)[None]))
        else:  # LeRobot's policies keep their chunks under these names
            queues = getattr(self._policy, "_queues", {})
            for queue in (getattr(self._policy, "_action_queue", None), queues.get(ACTION)):
                if queue is not None:
                    queue.clear()

    def _normalized(self, action: torch.Tensor) -> torch.Tensor:
        from lerobot.lerobot_types import TransitionKey
        from lerobot.processor import NormalizerProcessorStep
        from lerobot.processor.converters import create_transition

        transition = create_transition(action=action)
        for step in self._before.steps:
            if isinstance(step, NormalizerProcessorStep):
                transition = step(transition)
        normalized: torch.Tensor = transition[TransitionKey.ACTION]
        return normalized


def _batch(observation: Observation, instruction: str) -> dict[str, Any]:
    """Returns an observation as a batch of size one, in the form of a dataset row."""
    import torch

    batch: dict[str, Any] = {"task": [instruction]}
    for key, value in observation_columns(observation).items():
        tensor = torch.from_numpy(value)[None]
        batch[key] = tensor.permute(0, 3, 1, 2).float() / 255 if is_image_column(key) else tensor
    return batch
