"""``dp3_adaptive``: a policy over point clouds with a memory of its own actions.

Paper, section 4.2: P(A_t | O_t, A^_t), observations O_t and *action history* A^_t. A *head* draws the next actions:
``diffusion``, the paper's, or ``anchors``, the default, which is no diffusion.
"""

import copy
from collections import deque
from typing import Any

import torch
from torch import Tensor

from lerobot_adamanip.contract import schema
from lerobot_adamanip.lerobot_patches.batched_reading import read_in_batches
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_policy_adamanip.common.motion_clusters import demonstrated_motions, warn_of_other_motions
from lerobot_policy_adamanip.common.policy import ChunkGuard, CloudPolicy
from lerobot_policy_adamanip.common.tool_frame import mirrored_motions
from lerobot_policy_adamanip.common.torch_rotations import orthonormal_6d
from lerobot_policy_adamanip.dp3_adaptive.anchors import AnchorHead
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.diffusion import BaseDiffusionHead
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION
from lerobot_policy_adamanip.dp3_adaptive.tool_diffusion import ToolDiffusionHead
from lerobot_policy_adamanip.dp3_adaptive.training_windows import TrainingWindows, Window, balanced_weights

TASK_INDEX = "task_index"


def _clear_ema_count(policy: "DP3AdaptivePolicy", _: Any) -> None:
    """Resets the cached count of updates, because loading weights changes its buffer."""
    policy._ema_count = None


class DP3AdaptivePolicy(CloudPolicy):
    """LeRobot policy. Training uses `forward`; at run time `select_action` keeps the histories.

    A training batch holds the present row. Earlier and later rows are looked up by its ``index``, in columns that are
    read when the policy is created. For H = ``n_action_history_steps`` and T = ``horizon``::

        executed  step t-H ... t-1      labels  step t ... t+T-1

    At run time the history is a queue of the normalised actions that `select_action` returned, one per step. Rotations
    are orthonormalised and grippers clipped, as in recorded actions. History before the episode's start is masked, in
    training and at run time. Missing first observations repeat the first one, as LeRobot's padding does.

    Args:
        dataset_stats: of the training data; convert normalised values to metres. Not needed to load a checkpoint.
        dataset_meta: of the training data, with its files. Needed for training only.
    """

    config_class = DP3AdaptiveConfig
    name = "dp3_adaptive"

    def __init__(
        self, config: DP3AdaptiveConfig, *, dataset_stats: dict | None = None, dataset_meta: Any = None, **kwargs: Any
    ):
        super().__init__(config)
        if config.frame == "tool":
            config.require_poses()
        config.require_action()
        self.head = self._make_head(dataset_stats)
        self.model = self.head.network()
        # Part of the policy, so that averaged weights are saved, resumed and evaluated.
        self.ema_model = copy.deepcopy(self.model).requires_grad_(False)
        self.register_buffer("ema_steps", torch.zeros((), dtype=torch.int64))
        self._ema_count: int | None = None  # set when `update` reads the buffer
        self.register_load_state_dict_post_hook(_clear_ema_count)
        self._attach_dataset(dataset_meta, is_trained=config.pretrained_path is not None)
        if self._windows is not None and config.frame == "tool":
            self.fit_anchors(*demonstrated_motions(self._windows.recorded))
        self.reset()

    def _make_head(self, stats: schema.Statistics | None) -> AnchorHead | BaseDiffusionHead | ToolDiffusionHead:
        if self.config.head == "anchors":
            return AnchorHead(self.config)
        if self.config.frame == "tool":
            return ToolDiffusionHead(self.config)
        return BaseDiffusionHead(self.config, stats)

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path, *, dataset_stats: dict | None = None, dataset_meta: Any = None, **kwargs
    ):
        """Loads a checkpoint as LeRobot does. Units of clouds and typical motions stay the checkpoint's."""
        policy = super().from_pretrained(pretrained_name_or_path, **kwargs)
        policy._attach_dataset(dataset_meta, is_trained=True)
        if policy._windows is not None and policy.config.frame == "base" and policy.config.has_pose_layout:
            # LeRobot reads them next, for the processors of a fine-tuned policy, without calling the policy.
            dataset_meta.stats = schema.fix_pose_statistics(dataset_meta.stats)
        if policy._windows is not None and policy.config.frame == "tool":
            motions, _ = demonstrated_motions(policy._windows.recorded)
            warn_of_other_motions(motions, policy.model.motions.anchors, policy.model.motions.spread)
        return policy

    def _attach_dataset(self, dataset_meta: Any, *, is_trained: bool) -> None:
        """Reads the dataset columns for training."""
        self._task_weights: Tensor | None = None
        self._windows: TrainingWindows | None = None
        if dataset_meta is None:
            return
        read_in_batches(dataset_meta)
        self.match_clouds(dataset_meta, is_trained=is_trained)
        self._windows = TrainingWindows(self.config, dataset_meta)
        if self.config.balance_tasks:
            self._task_weights = balanced_weights(dataset_meta)

    def fit_anchors(self, motions: Tensor, openings: Tensor) -> None:
        """Fits an untrained policy's anchors to demonstrated motions (M, 7) [m, rad, -] of hands with openings (M,)."""
        if self.config.augmentation_mirror:
            motions, openings = torch.cat([motions, mirrored_motions(motions)]), openings.repeat(2)
        self.model.motions.fit(motions, openings)
        self.ema_model.motions.load_state_dict(self.model.motions.state_dict())

    # Training ---------------------------------------------------------------------------------------------------

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Returns the head's loss (with ``diffusion``: paper, eq. 2) over valid labels, and metrics.

        Args:
            batch: normalised, with S = n_obs_steps: ``observation.point_cloud`` (B, N, 3) metres,
                ``observation.state`` (B, D), ``action`` (B, A), ``index`` (B,). Observations are (B, S, ...) for S > 1.
            reduction: ``mean``, or ``none`` for one loss per sample (B,), whose mean is the loss.
        """
        window, actions, is_label = self.training_window(batch)
        losses, weights, metrics = self.head.loss(self._active_model(), window, actions, is_label)
        if self._task_weights is not None:
            self._task_weights = self._task_weights.to(losses)
            weights = weights * self._task_weights[batch[TASK_INDEX]]
        if require_choice("reduction", reduction, ("mean", "none")) == "none":
            return len(losses) * losses * weights / weights.sum().clamp(min=1), {}
        # One transfer for all metrics, because each would synchronise with a GPU.
        metrics = dict(zip(metrics, torch.stack(list(metrics.values())).tolist(), strict=True)) if metrics else {}
        return (losses * weights).sum() / weights.sum().clamp(min=1), metrics

    def training_window(self, batch: dict[str, Tensor]) -> tuple[Window, Tensor, Tensor]:
        """Returns the head's inputs, labels (B, T, A) and a mask of valid labels (B, T); see `forward`."""
        if self._windows is None:
            raise ConfigurationError(
                "The policy has nothing to learn from.",
                got="a policy created without a dataset",
                allowed="make_policy(config, ds_meta=dataset.meta)",
                hint="lerobot-train --policy.type=dp3_adaptive --dataset.root=DIR",
            )
        return self._windows.of(batch, self._observations(batch))

    def _get_default_peft_targets(self) -> None:
        self._validate_peft_config(None)

    def _validate_peft_config(self, peft_config: Any) -> None:
        """Raises `ConfigurationError`: an adapter is not averaged, and the averaged weights act."""
        raise ConfigurationError(
            "dp3_adaptive cannot be trained with PEFT: its averaged weights, which act, have no adapters.",
            got="--peft.*",
            allowed=f"a training of all {sum(weight.numel() for weight in self.model.parameters())} weights",
            hint="--policy.path=CHECKPOINT without --peft.*",
        )

    @torch.no_grad()
    def update(self) -> None:
        """Updates the averaged weights; lerobot-train calls this after each optimizer step."""
        # Counted in Python too: reading the buffer would synchronise with a GPU at every step.
        self._ema_count = (int(self.ema_steps) if self._ema_count is None else self._ema_count) + 1
        self.ema_steps += 1
        decay = min(1 - (1 + self._ema_count) ** -self.config.ema_power, self.config.ema_max)
        torch._foreach_lerp_(list(self.ema_model.parameters()), list(self.model.parameters()), 1 - decay)

    # Run time ---------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Clears the histories at an episode's start."""
        self._observed: deque[dict[str, Tensor]] = deque(maxlen=self.config.observed_steps)
        self._executed: deque[Tensor] = deque(maxlen=max(1, self.config.n_action_history_steps))
        self._action_queue: deque[Tensor] = deque()  # LeRobot after 0.6.1 clears it, by name, for a new instruction
        self._chunks = ChunkGuard(self.name)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the next action (B, A), normalised, and stores it in the history.

        ``batch`` is one normalised observation: cloud (B, N, 3) [m], state (B, D). The head samples from ``noise``
        (B, T, A); None draws the noise.
        """
        observation = self._single(batch)
        self._chunks.select()
        self._observed.append(self._kept(observation))
        while len(self._observed) < self.config.observed_steps:
            self._observed.append(self._observed[-1])
        if not self._action_queue:
            chunk = self._generate(observation, list(self._observed), noise)
            self._action_queue.extend(chunk[:, : self.config.n_action_steps].unbind(dim=1))
        action = self._action_queue.popleft()
        self._executed.append(self._as_executed(action))
        return action

    def _as_executed(self, action: Tensor) -> Tensor:
        """Returns an action (B, A) as the environment receives it, normalised."""
        if self.config.frame == "tool" or not self.config.has_pose_layout:
            return action
        rotation, gripper = orthonormal_6d(action[:, schema.ROTATION_DIMS]), action[:, schema.GRIPPER_DIM :].clamp(0, 1)
        return torch.cat([action[:, schema.POSITION_DIMS], rotation, gripper], dim=-1)

    def replace_latest(self, action: Tensor) -> None:
        """Replaces the latest executed action by another one (B, A), normalised, and drops the rest of its chunk."""
        self._executed[-1] = action.to(self._executed[-1])
        self._action_queue.clear()

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the chunk (B, T, A) for ``batch`` and the history, without changing the history.

        With a history of actions, see `ChunkGuard`. Observed steps that `select_action` has not seen repeat the first.
        """
        observed = deque(self._observed, maxlen=self.config.observed_steps)
        observation = self._single(batch)
        if self.config.n_action_history_steps:
            self._chunks.predict(observation)
        observed.append(self._kept(observation))
        while len(observed) < self.config.observed_steps:
            observed.appendleft(observed[0])
        return self._generate(observation, list(observed), noise)

    def _kept(self, observation: dict[str, Tensor]) -> dict[str, Tensor]:
        """Returns the part of an observation to store: in the tool's frame only the state."""
        return {schema.STATE: observation[schema.STATE]} if self.config.frame == "tool" else observation

    def executed_history(self, batch_size: int, like: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the run-time history: actions (B, H, A), oldest first and zero before the start; validity (B, H)."""
        length, dims = self.config.n_action_history_steps, self.config.action_feature.shape[0]
        history = torch.zeros(batch_size, length, dims, device=like.device, dtype=like.dtype)
        valid = torch.zeros(batch_size, length, dtype=torch.bool, device=like.device)
        known = list(self._executed)[-length:] if length else []
        if known:
            history[:, -len(known) :] = torch.stack(known, dim=1).to(history)
            valid[:, -len(known) :] = True
        return history, valid

    def _generate(self, present: dict[str, Tensor], observed: list[dict[str, Tensor]], noise: Tensor | None) -> Tensor:
        observations = {key: value[:, None] for key, value in present.items() if key not in observed[0]}
        observations |= {key: torch.stack([step[key] for step in observed], dim=1) for key in observed[0]}
        window = Window(
            observations, *self.executed_history(len(observations[schema.STATE]), observations[schema.STATE])
        )
        return self.head.sample(self._active_model(), window, noise)

    # Shared -----------------------------------------------------------------------------------------------------

    def _active_model(self) -> Any:
        """Returns the trained weights in training mode, else the averaged ones."""
        return self.model if self.training or int(self.ema_steps) == 0 else self.ema_model

    def _observations(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Returns the inputs, with the instruction if it is used."""
        picked = self.pick_inputs(batch)
        if self.config.use_instruction:
            # Equal at all steps of a window, so its time axis has length 1.
            picked[INSTRUCTION] = batch[INSTRUCTION][:, None] if picked[schema.STATE].dim() == 3 else batch[INSTRUCTION]
        return picked

    def _single(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Returns one step's inputs, each (B, ...). Adds missing batch dimensions to clouds; LeRobot does to states."""
        observation = self._observations(batch)
        if observation[schema.POINT_CLOUD].dim() == 2:
            observation[schema.POINT_CLOUD] = observation[schema.POINT_CLOUD][None]
        return observation
