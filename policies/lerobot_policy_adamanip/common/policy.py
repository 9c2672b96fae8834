"""Base of the policies: strict loading of checkpoints, selection of inputs, and a model card for the Hub."""

import copy
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from lerobot_adamanip.contract.control import DENSE, KEYFRAME, RATES
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.schema import ACTION_DIM, FPS, KEY_FRAME, POINT_CLOUD, STATE
from lerobot_adamanip.datasets.dataset import camera_of, workspace_of
from lerobot_adamanip.util.errors import ConfigurationError, listed
from lerobot_policy_adamanip.common.config import CloudPolicyConfig
from lerobot_policy_adamanip.common.inputs import pick_inputs

_logger = logging.getLogger(__name__)


class CloudPolicy(PreTrainedPolicy):
    """Base of LeRobot policies with one trained network, ``model``."""

    config_class: ClassVar[type[CloudPolicyConfig]] = CloudPolicyConfig
    name: ClassVar[str] = "cloud_policy"
    config: Any
    model: torch.nn.Module

    def __init__(self, config: CloudPolicyConfig) -> None:
        super().__init__(config)
        config.validate_features()

    def match_clouds(self, dataset_meta: Any, *, is_trained: bool) -> None:
        """Stores a dataset's workspace and camera in the configuration: clouds from a robot's depth need both.

        Raises `ConfigurationError` if the weights were trained with another workspace or camera.
        """
        box, camera = workspace_of(Path(dataset_meta.root), dataset_meta.features), camera_of(dataset_meta.features)
        config = self.config
        if not is_trained:
            config.workspace_lower, config.workspace_upper, config.depth_camera = box.lower, box.upper, camera
            return
        trained = Workspace(tuple(config.workspace_lower), tuple(config.workspace_upper))
        if (trained, config.depth_camera) != (box, camera):
            raise ConfigurationError(
                "The dataset's clouds have another workspace or camera than those that the checkpoint was trained on.",
                got=f"{box}, camera {camera}",
                allowed=f"{trained}, camera {config.depth_camera}",
                hint="new weights: --policy.type instead of --policy.path",
            )

    def match_control(self, dataset_meta: Any, *, is_trained: bool) -> None:
        """Stores a dataset's rate of control in the configuration.

        Raises `ConfigurationError` if the policy is for another control, or weights were trained at another rate.
        """
        config, fps = self.config, dense_fps(dataset_meta)
        if config.control not in (None, KEYFRAME if fps is None else DENSE):
            raise ConfigurationError(
                f"This policy needs {'key frames' if config.control == KEYFRAME else 'data at control rate'}.",
                got=f"{'key frames' if fps is None else f'rows at {fps} Hz'} in {dataset_meta.root}",
                allowed="one row per key frame" if config.control == KEYFRAME else f"rows at {listed(RATES)} Hz",
                hint="--policy.type=dp3_adaptive --policy.preset=" + ("keyframe" if fps is None else "dense, or dp3"),
            )
        if is_trained and config.control_fps != fps:
            raise ConfigurationError(
                "The dataset has another rate of control than the one that the checkpoint was trained on.",
                got="key frames" if fps is None else f"{fps} Hz",
                allowed="key frames" if config.control_fps is None else f"{config.control_fps} Hz",
                hint="new weights: --policy.type instead of --policy.path",
            )
        config.control_fps = fps

    def get_optim_params(self) -> Any:
        """Returns the parameters to train, after checking that the result can be published."""
        self.require_own_push()
        return self.model.parameters()

    @classmethod
    def _load_as_safetensor(cls, model: Any, model_file: str, map_location: str, strict: bool) -> Any:
        """Loads strictly; LeRobot's default would leave missing weights at random values.

        Raises `ConfigurationError` for other weights, and for options that change what the weights see or mean.
        """
        folder = Path(model_file).parent
        if (folder / "config.json").is_file():  # absent for weights of another revision than main, from the Hub
            require_trained_options(model.config, folder)
        log_training_objects(folder)
        try:
            return super()._load_as_safetensor(model, model_file, map_location, True)
        except RuntimeError as error:
            reasons = [line.strip() for line in str(error).splitlines() if line.strip()]
            raise ConfigurationError(
                f"The checkpoint {folder} does not fit this policy.",
                got="; ".join(reasons[:3])[:400],
                allowed="weights saved with the same options",
                hint="leave --policy.* options as in its config.json",
            ) from error

    # Inputs ---------------------------------------------------------------------------------------------------------

    def observed(self, batch: Mapping[str, Any]) -> tuple[Tensor, Tensor]:
        """Returns clouds (B, N, 3) [m] and tool poses (B, 10) of one observation.

        Adds a missing batch dimension to clouds; LeRobot adds it to states only.
        """
        picked = pick_inputs(self.config, batch)
        cloud, pose = picked[POINT_CLOUD], picked[STATE][..., :ACTION_DIM]
        return (cloud[None] if cloud.dim() == 2 else cloud).float(), pose.float()

    # Publishing -----------------------------------------------------------------------------------------------------

    def require_own_push(self) -> None:
        """Raises `ConfigurationError` if ``push_to_hub`` is set and this LeRobot would publish local paths.

        LeRobot 0.6.1 calls the policy for its card and training configuration; later versions have no such hook.
        """
        if self.config.push_to_hub and self.config.repo_id and not hasattr(PreTrainedPolicy, "generate_model_card"):
            raise ConfigurationError(
                "This LeRobot publishes a policy with the local paths of its training.",
                got=f"--policy.push_to_hub=true, to {self.config.repo_id}",
                allowed="--policy.push_to_hub=false",
                hint="train with --policy.push_to_hub=false, then adamanip push model CHECKPOINT --repo-id USER/NAME",
            )

    def push_to_hub(self, *args: Any, **kwargs: Any) -> Any:
        """Uploads as LeRobot does, after `require_own_push`."""
        self.require_own_push()
        return super().push_to_hub(*args, **kwargs)

    def generate_model_card(self, *args: Any, cfg: Any = None, dataset_meta: Any = None, **kwargs: Any) -> Any:
        """Returns the card of `adamanip push model`; LeRobot's own is validated online, without ``HF_ENDPOINT``."""
        import draccus
        from huggingface_hub import ModelCard

        from lerobot_adamanip.datasets.cards import check_card
        from lerobot_adamanip.hub.model_card import Checkpoint, model_card
        from lerobot_adamanip.hub.portable_config import shareable

        updates = getattr(self, "ema_steps", None)
        checkpoint = Checkpoint(
            shareable({**draccus.encode(self.config), "type": self.config.type}),
            {} if cfg is None else shareable(draccus.encode(cfg)),
            sum(each.numel() for each in self.model.parameters()),
            None if updates is None else int(updates),
        )
        text = model_card(checkpoint, self.config.repo_id or "USER/NAME")
        check_card(text, "model")
        return ModelCard(text)

    def push_model_to_hub(self, cfg: Any, *args: Any, **kwargs: Any) -> None:
        """Uploads as LeRobot does, with local paths removed from the configurations."""
        from lerobot_adamanip.hub.portable_config import is_local, shareable

        kept = self.config
        if is_local(kept.pretrained_path):
            self.config = copy.deepcopy(kept)
            self.config.pretrained_path = None
        try:
            super().push_model_to_hub(shareable(cfg), *args, **kwargs)
        finally:
            self.config = kept


def require_trained_options(config: CloudPolicyConfig, checkpoint: Path) -> None:
    """Raises `ConfigurationError` for options that a checkpoint's weights were not trained with."""
    trained = PreTrainedConfig.from_pretrained(checkpoint)
    if isinstance(trained, type(config)) and (changed := config.changed_options(trained)):
        raise ConfigurationError(
            f"The checkpoint {checkpoint} was trained with another {', '.join(changed)}.",
            got=", ".join(f"{name}={own}" for name, (own, _) in changed.items()),
            allowed=", ".join(f"{name}={value}" for name, (_, value) in changed.items()),
            hint=f"leave {' '.join(f'--policy.{name}' for name in changed)} out, or train new weights",
        )


def dense_fps(dataset_meta: Any) -> int | None:
    """Returns the rows per second of a dense dataset, also of a recording; None for key frames."""
    is_dense = KEY_FRAME in dataset_meta.features or dataset_meta.fps != FPS
    return int(dataset_meta.fps) if is_dense else None


def log_training_objects(checkpoint: Path) -> None:
    """Logs the objects a checkpoint was trained on, from its ``train_config.json``, if the dataset is available."""
    from lerobot_adamanip.datasets.training_data import training_objects

    if objects := training_objects(checkpoint):
        _logger.info("The policy was trained on %d objects: %s.", len(objects), listed(objects))


class ChunkGuard:
    """Raises an error if chunks are requested from a policy whose history misses the executed actions.

    `select_action` stores the action that it returns. LeRobot's asynchronous policy server calls only
    `predict_action_chunk`, so the history would stay empty.
    """

    def __init__(self, policy_type: str) -> None:
        self._policy_type = policy_type
        self._predicted: Mapping[str, Tensor] | None = None

    def select(self) -> None:
        """Records a call of `select_action`; any observation may follow it."""
        self._predicted = None

    def predict(self, observation: Mapping[str, Tensor]) -> None:
        """Raises `ConfigurationError` for a new observation without a call of `select_action` since the last one."""
        latest = self._predicted or observation
        if any(not torch.equal(latest[key], observation[key]) for key in (POINT_CLOUD, STATE)):
            raise ConfigurationError(
                f"{self._policy_type} has a history and needs to know which actions were executed.",
                got="predict_action_chunk for another observation, without select_action since the first",
                allowed="select_action for each observation; reset() at the start of an episode",
                hint="lerobot-rollout --inference.type=sync, instead of rtc or the asynchronous policy server",
            )
        self._predicted = latest
