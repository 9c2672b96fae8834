"""``dp3_adaptive``: a policy over point clouds with a memory of its own actions.

Paper, section 4.2: P(A_t | O_t, A^_t), observations O_t and *action history* A^_t. A *head* draws the next actions from
a `Window` of both. `DP3AdaptivePolicy` makes windows, in training from recorded rows and at run time from its own
history. `TruncatedHead`, the default, denoises around a typical motion of the demonstrations. Start with
`select_action` and `TruncatedHead.sample`. Read on in `common.contacts` (past key frames and memory), `no_repeat`
(a baseline at inference) and `diffusion` (the heads for chunks of actions).
"""

import copy
from collections import deque
from typing import Any

import torch
from lerobot.configs import parser
from lerobot.lerobot_types import TransitionKey
from lerobot.processor import NormalizerProcessorStep, create_transition
from torch import Tensor

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import DENSE
from lerobot_adamanip.lerobot_patches.batched_reading import read_in_batches
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_policy_adamanip.common import geometry, inputs, strokes
from lerobot_policy_adamanip.common.contacts import END
from lerobot_policy_adamanip.common.earlier_episodes import EarlierEpisodes
from lerobot_policy_adamanip.common.inputs import Window
from lerobot_policy_adamanip.common.motion_clusters import demonstrated_motions, warn_of_other_motions
from lerobot_policy_adamanip.common.policy import ChunkGuard, CloudPolicy
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import INSTRUCTION, MIRRORING
from lerobot_policy_adamanip.dp3_adaptive.truncated import TruncatedHead

EMA_POWER, EMA_MAX = 0.75, 0.9999
"""The averaged weights' decay at step n is 1 - (1 + n)^-`EMA_POWER`, at most `EMA_MAX`."""


class DP3AdaptivePolicy(CloudPolicy):
    """LeRobot policy. Training uses `forward`; at run time `select_action` keeps the histories.

    A training batch holds the present row. Earlier and later rows are looked up by its ``index``, in columns that are
    read when the policy is created. For H = ``n_action_history_steps`` and T = ``horizon``::

        executed  step t-H ... t-1      labels  step t ... t+T-1

    At control rate (preset ``dense``) H counts strokes instead of steps, see `common.strokes`.

    At run time the history is a queue of the normalised actions that `select_action` returned, one per step. Rotations
    are orthonormalised and grippers clipped, as in recorded actions. History before the episode's start is masked, in
    training and at run time. Missing first observations repeat the first one, as LeRobot's padding does.

    Args:
        dataset_stats: statistics of the training data, for units in metres. Not needed to load a checkpoint.
        dataset_meta: metadata of the training data, with its files. Needed for training only.
    """

    config_class = DP3AdaptiveConfig
    name = "dp3_adaptive"

    def __init__(
        self, config: DP3AdaptiveConfig, *, dataset_stats: dict | None = None, dataset_meta: Any = None, **kwargs: Any
    ):
        super().__init__(config)
        self._sees_from_tool = config.method.frame == "tool"
        self._has_strokes = self._sees_from_tool and config.control == DENSE and config.n_action_history_steps > 0
        if self._sees_from_tool:
            config.require_poses()
        config.require_action()
        # The tool's frame needs the poses before the past actions too.
        self._observed_steps = 1 + config.n_action_history_steps if self._sees_from_tool else config.n_obs_steps
        if self._has_strokes:
            self._observed_steps = 1  # at least: strokes have any number of steps
        self.model = self._make_head(dataset_stats)
        # Part of the policy, so that averaged weights are saved, resumed and evaluated. It shares the configuration.
        self.ema_model = copy.deepcopy(self.model, {id(config): config}).requires_grad_(False)
        self.register_buffer("ema_steps", torch.zeros((), dtype=torch.int64))
        self._ema_count: int | None = None  # set when `update` reads the buffer
        self.register_load_state_dict_post_hook(lambda policy, _: setattr(policy, "_ema_count", None))
        self._attach_dataset(dataset_meta, is_trained=config.pretrained_path is not None)
        if self.recorded is not None and config.method.has_anchors:
            self.fit_anchors(demonstrated_motions(self.recorded))
        self._episodes, self._has_acted = 0, False
        self.reset()

    def _make_head(self, stats: schema.Statistics | None) -> Any:
        if self.config.method.head == "truncated":
            return TruncatedHead(self.config)
        from lerobot_policy_adamanip.dp3_adaptive import diffusion  # imports diffusers

        if self._sees_from_tool:
            return diffusion.MemoryDiffusionHead(self.config)
        return diffusion.BaseDiffusionHead(self.config, stats)

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path, *, dataset_stats: dict | None = None, dataset_meta: Any = None, **kwargs
    ):
        """Loads a checkpoint as LeRobot does. Units of clouds and typical motions stay the checkpoint's."""
        policy = super().from_pretrained(pretrained_name_or_path, **kwargs)
        policy._attach_dataset(dataset_meta, is_trained=True)
        if policy.recorded is not None and policy.config.method.has_anchors:
            motions = policy.model.motions
            warn_of_other_motions(demonstrated_motions(policy.recorded), motions.anchors, motions.spread)
        elif policy.recorded is not None and not policy._sees_from_tool and policy.config.has_pose_layout:
            # LeRobot reads them next, for the processors of a fine-tuned policy, without calling the policy.
            dataset_meta.stats = schema.fix_pose_statistics(dataset_meta.stats)
        return policy

    def _attach_dataset(self, dataset_meta: Any, *, is_trained: bool) -> None:
        """Reads the dataset columns for training."""
        self.recorded: inputs.RecordedRows | None = None
        self._earlier: EarlierEpisodes | None = None
        self._batch_is_checked = False
        if dataset_meta is None:
            return
        if self.config.augmentation_mirror and not self.config.has_pose_layout:
            raise ConfigurationError(
                "Only poses can be mirrored.",
                got=f"augmentation_mirror={self.config.augmentation_mirror}, actions or states of another kind",
                allowed=f"actions of {schema.ACTION_DIM} numbers and states that begin with them",
                hint="adamanip collect DIR --control dense --action ee_pose --state full; or train without mirroring",
            )
        read_in_batches(dataset_meta)
        self.match_clouds(dataset_meta, is_trained=is_trained)
        self.match_control(dataset_meta, is_trained=is_trained)
        self.recorded, config = inputs.read_recorded_rows(dataset_meta, has_strokes=self._has_strokes), self.config
        if share := config.augmentation_earlier_episodes:
            self._earlier = EarlierEpisodes(dataset_meta, share, config.n_action_history_steps)
        stats = dataset_meta.stats
        if config.has_pose_layout and stats:
            stats = schema.fix_pose_statistics(stats)
        features = {schema.STATE: config.input_features[schema.STATE], schema.ACTION: config.action_feature}
        self._normalize = NormalizerProcessorStep(features, config.normalization_mapping, stats)

    def fit_anchors(self, motions: Tensor) -> None:
        """Fits an untrained policy's anchors to demonstrated motions (M, 7) [m, rad, -]."""
        if self.config.augmentation_mirror:
            motions = torch.cat([motions, geometry.mirrored_motions(motions)])
        self.model.motions.fit(motions)
        self.ema_model.motions.load_state_dict(self.model.motions.state_dict())

    # Training: batch -> window -> loss ------------------------------------------------------------------------------

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Returns the head's loss (paper, eq. 2) over valid labels, and metrics.

        Args:
            batch: normalised, with S = n_obs_steps: ``observation.point_cloud`` (B, N, 3) metres,
                ``observation.state`` (B, D), ``action`` (B, A), ``index`` (B,). Observations are (B, S, ...) for S > 1.
            reduction: ``mean``, or ``none`` for one loss per sample (B,), whose mean is the loss.
        """
        window, actions, is_label = self.training_window(batch)
        losses, weights, metrics = self._active_model().loss(window, actions, is_label)
        if reduction != "mean":
            require_choice("reduction", reduction, ("mean", "none"))
            return len(losses) * losses * weights / weights.sum().clamp(min=1), {}
        # One transfer for all metrics, because each would synchronise with a GPU.
        metrics = dict(zip(metrics, torch.stack(list(metrics.values())).tolist(), strict=True)) if metrics else {}
        return (losses * weights).sum() / weights.sum().clamp(min=1), metrics

    def training_window(self, batch: dict[str, Tensor]) -> tuple[Window, Tensor, Tensor]:
        """Returns the head's inputs, labels (B, T, A) and a mask of valid labels (B, T); see `forward`.

        Past actions are the executed ones: where a policy drove, the labels are corrections. A chunk's labels end where
        one of its key frames was executed otherwise: the later ones answer a state that the chunk does not lead to.
        """
        recorded, steps = self.recorded, self.config.n_action_history_steps
        if recorded is None:
            raise ConfigurationError(
                "The policy has nothing to learn from.",
                got="a policy created without a dataset",
                allowed="make_policy(config, ds_meta=dataset.meta)",
                hint="lerobot-train --policy.type=dp3_adaptive --dataset.root=DIR",
            )
        observations = self._observations(batch)
        if observations[schema.STATE].dim() == 2:
            observations = {key: value[:, None] for key, value in observations.items()}
        rows = recorded.rows(batch[inputs.INDEX])
        executed, starts, valid, is_known = self._recorded_history(recorded, rows)
        ahead, exists = recorded.around(rows, range(self.config.horizon))
        actions = torch.cat([executed, recorded.column(schema.ACTION, ahead)], dim=1)
        actions = self._prepared(batch, schema.ACTION, actions)
        if not self._batch_is_checked:
            share = batch[MIRRORING].share if MIRRORING in batch else 0.0
            inputs.check_batch(self.config, batch, observations[schema.STATE], actions[:, steps], share)
            self._batch_is_checked = True
        if self._sees_from_tool and steps:
            states = self._prepared(batch, schema.STATE, recorded.column(schema.STATE, starts))
            observations[schema.STATE] = torch.cat([states, observations[schema.STATE]], dim=1)
        departs = recorded.column(inputs.DEPARTS, ahead).int()
        is_label = exists & recorded.column(inputs.IS_LABEL, ahead) & (departs.cumsum(dim=1) == departs)
        return Window(observations, actions[:, :steps], valid), actions[:, steps:], is_label & is_known[:, None]

    def _recorded_history(self, recorded: inputs.RecordedRows, rows: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Returns the history of rows (B,): executed actions (B, H, A), positions (B, H) of the poses before them, and
        validity (B, H); and whether the rows' actions are training labels (B,).
        """
        steps = self.config.n_action_history_steps
        if self._has_strokes:
            starts, before, valid = recorded.strokes(rows, steps)
        else:
            before, valid = recorded.around(rows, range(-steps, 0))
            starts = before
        if self._earlier is None or not self.training:
            return recorded.column(schema.EXECUTED, before), starts, valid, torch.ones_like(rows, dtype=torch.bool)
        before, valid, is_last, is_known = self._earlier.continued(rows, before, valid)
        executed = recorded.column(schema.EXECUTED, before)
        executed[..., schema.GRIPPER_DIM].masked_fill_(is_last, END)  # as `reset` at run time
        return executed, before, valid, is_known

    def _prepared(self, batch: dict[str, Any], key: str, recorded: Tensor) -> Tensor:
        """Mirrors and normalises recorded actions or states (B, T, D) like the batch."""
        values = batch[MIRRORING].poses(recorded) if MIRRORING in batch else recorded
        if key == schema.ACTION:
            return self._normalize(create_transition(action=values))[TransitionKey.ACTION]
        return self._normalize(create_transition(observation={key: values}))[TransitionKey.OBSERVATION][key]

    @torch.no_grad()
    def update(self) -> None:
        """Updates the averaged weights; lerobot-train calls this after each optimizer step.

        Only ``--resume=true`` continues the average of a checkpoint. A fine-tuning begins a new one: otherwise a third
        of the weights that act would still be the old ones after 8,000 steps and 1,000 further ones.
        """
        if self._ema_count is None and parser.parse_arg("resume") != "true":
            self.ema_steps.zero_()
        # Counted in Python too: reading the buffer would synchronise with a GPU at every step.
        self._ema_count = (int(self.ema_steps) if self._ema_count is None else self._ema_count) + 1
        self.ema_steps += 1
        decay = min(1 - (1 + self._ema_count) ** -EMA_POWER, EMA_MAX)
        torch._foreach_lerp_(list(self.ema_model.parameters()), list(self.model.parameters()), 1 - decay)

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

    # Run time: observation -> window -> action ----------------------------------------------------------------------

    def train(self, mode: bool = True) -> "DP3AdaptivePolicy":
        """Switches modes, and ends the memory over episodes: LeRobot calls ``eval()`` before each evaluation."""
        self._episodes = 0
        return super().train(mode)

    def reset(self) -> None:
        """Clears the histories at an episode's start; with ``memory_episodes`` of K, at every K-th.

        Only an episode in which the policy has acted counts: LeRobot also resets before the first one.
        """
        self._action_queue: deque[Tensor] = deque()  # LeRobot after 0.6.1 clears it, by name, for a new instruction
        self._chunks = ChunkGuard(self.name)
        self._episodes += self._episodes == 0 or self._has_acted
        self._has_acted = False
        if 1 < self._episodes <= self.config.memory_episodes:
            # The result of the last action was not observed, so it is no try, but an event of its own kind.
            self._executed[-1] = self._executed[-1].clone()
            self._executed[-1][:, schema.GRIPPER_DIM] = END
            return
        self._episodes = 1
        self._observed: deque[dict[str, Tensor]] = deque(maxlen=None if self._has_strokes else self._observed_steps)
        length = None if self._has_strokes else max(1, self.config.n_action_history_steps)
        self._executed: deque[Tensor] = deque(maxlen=length)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the next action (B, A), normalised, and stores it in the history.

        ``batch`` is one normalised observation: cloud (B, N, 3) [m], state (B, D). The head samples from ``noise``
        (B, T, A); None draws the noise.
        """
        observation = self._single(batch)
        self._chunks.select()
        self._append_observed(self._observed, observation)
        if not self._action_queue:
            chunk = self._generate(observation, self._observed, noise)
            self._action_queue.extend(chunk[:, : self.config.n_action_steps].unbind(dim=1))
        action, self._has_acted = self._action_queue.popleft(), True
        is_pose = self._sees_from_tool or not self.config.has_pose_layout
        self._executed.append(action if is_pose else geometry.valid_pose(action))
        return action

    def replace_latest(self, action: Tensor) -> None:
        """Replaces the latest executed action by another one (B, A), normalised, and drops the rest of its chunk."""
        self._executed[-1] = action.to(self._executed[-1])
        self._action_queue.clear()

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], noise: Tensor | None = None, **kwargs: Any) -> Tensor:
        """Returns the chunk (B, T, A) for ``batch`` and the history, without changing the history.

        With a history of actions, see `ChunkGuard`. Observed steps that `select_action` has not seen repeat the first.
        """
        observed = self._observed.copy()
        observation = self._single(batch)
        if self.config.n_action_history_steps:
            self._chunks.predict(observation)
        self._append_observed(observed, observation)
        return self._generate(observation, observed, noise)

    def _append_observed(self, observed: deque[dict[str, Tensor]], present: dict[str, Tensor]) -> None:
        """Appends a step, in the tool's frame only its state, and repeats it before the episode's start."""
        observed.append({schema.STATE: present[schema.STATE]} if self._sees_from_tool else present)
        observed.extendleft([observed[0]] * (self._observed_steps - len(observed)))

    def _generate(self, present: dict[str, Tensor], observed: deque[dict[str, Tensor]], noise: Tensor | None) -> Tensor:
        observations = {key: value[:, None] for key, value in present.items() if key not in observed[0]}
        observations |= {key: torch.stack([step[key] for step in observed], dim=1) for key in observed[0]}
        state = observations[schema.STATE]
        if self._has_strokes:
            commands = torch.stack([state[:, 0, : schema.ACTION_DIM], *self._executed], dim=1)[:, 1:]
            history, states, valid = strokes.merged(commands, state, self.config.n_action_history_steps)
            window = Window({**observations, schema.STATE: states}, history, valid)
        else:
            window = Window(observations, *self.executed_history(len(state), state))
        return self._active_model().sample(window, noise)

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

    def _active_model(self) -> Any:
        """Returns the trained head in training mode, else the averaged one."""
        return self.model if self.training or int(self.ema_steps) == 0 else self.ema_model

    def _observations(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Returns the inputs, with the instruction if it is used."""
        observations = inputs.pick_inputs(self.config, batch)
        if self.config.use_instruction:
            # Equal at all steps of a window, so its time axis has length 1.
            has_steps = observations[schema.STATE].dim() == 3
            observations[INSTRUCTION] = batch[INSTRUCTION][:, None] if has_steps else batch[INSTRUCTION]
        return observations

    def _single(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Returns one step's inputs, each (B, ...). Adds missing batch dimensions; LeRobot does to states."""
        observation = self._observations(batch)
        if observation[schema.POINT_CLOUD].dim() == 3:
            return observation
        return {key: value if key in (schema.STATE, INSTRUCTION) else value[None] for key, value in observation.items()}
