"""Inputs of a head; training looks them up by the ``index`` of a batch's rows."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import torch
from lerobot.lerobot_types import TransitionKey
from lerobot.processor import NormalizerProcessorStep, create_transition
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION, EXECUTED, STATE, fix_pose_statistics
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.recorded_rows import INDEX, IS_LABEL, read_recorded_rows, trained_episodes
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import SCENE_MOTION


@dataclass(frozen=True)
class Window:
    """Inputs of a head, normalised, with S observed steps and H remembered actions.

    Attributes:
        observations: cloud (B, S or 1, N, 3) [m], state (B, S, D), effort (B, S, 7) if used; the last is the present.
            The instruction (B, S or 1, 64) if used.
        history: (B, H, A) actions, oldest first. Rows before an episode's start hold the *label*, so they must be
            masked, in training and at run time.
        valid: (B, H) bool.
    """

    observations: dict[str, Tensor]
    history: Tensor
    valid: Tensor


class TrainingWindows:
    """A head's inputs and targets from a dataset's states, labels and executed actions, normalised by its ``stats``."""

    def __init__(self, config: DP3AdaptiveConfig, dataset_meta: Any) -> None:
        self._config, self.recorded = config, read_recorded_rows(dataset_meta)
        stats = dataset_meta.stats
        if config.has_pose_layout and stats:
            stats = fix_pose_statistics(stats)
        assert config.input_features is not None
        assert config.action_feature is not None
        features = {STATE: config.input_features[STATE], ACTION: config.action_feature}
        self._normalize = NormalizerProcessorStep(features, config.normalization_mapping, stats)
        self._is_checked = False

    def of(self, batch: dict[str, Any], observations: dict[str, Tensor]) -> tuple[Window, Tensor, Tensor]:
        """Returns inputs, labels (B, T, A), and a mask of valid labels (B, T).

        Past actions are the executed ones: where a policy drove, the labels are corrections.

        Args:
            batch: preprocessed, with ``index`` (B,).
            observations: of the batch: (B, ...) for the present only, or (B, S, ...) for S = n_obs_steps.
        """
        config, recorded = self._config, self.recorded
        if observations[STATE].dim() == 2:
            observations = {key: value[:, None] for key, value in observations.items()}
        self._check_steps(observations[STATE])
        past, rows = config.n_action_history_steps, recorded.rows(batch[INDEX])
        before, valid = recorded.around(rows, range(-past, 0))
        ahead, exists = recorded.around(rows, range(config.horizon))
        actions = torch.cat([recorded.column(EXECUTED, before), recorded.column(ACTION, ahead)], dim=1)
        actions = self._prepare(batch, ACTION, actions)
        if not self._is_checked:
            self._check_augmentation(batch)
            self._check_first(batch, actions[:, past])
        if config.observed_steps > config.n_obs_steps:
            states = self._prepare(batch, STATE, recorded.column(STATE, before))
            observations = {**observations, STATE: torch.cat([states, observations[STATE]], dim=1)}
        window = Window(observations, actions[:, :past], valid)
        return window, actions[:, past:], exists & recorded.column(IS_LABEL, ahead)

    def _prepare(self, batch: dict[str, Any], key: str, recorded: Tensor) -> Tensor:
        """Augments and normalises recorded actions or states (B, T, D) like the batch."""
        moved = batch[SCENE_MOTION].poses(recorded) if SCENE_MOTION in batch else recorded
        plain = create_transition(action=moved) if key == ACTION else create_transition(observation={STATE: moved})
        done = self._normalize(plain)
        result: Tensor = done[TransitionKey.ACTION] if key == ACTION else done[TransitionKey.OBSERVATION][STATE]
        return result

    def _check_steps(self, state: Tensor) -> None:
        """Raises `ConfigurationError` unless states (B, S, D) have the observed steps of the configuration."""
        wanted = self._config.n_obs_steps
        if state.shape[1] != wanted:
            raise ConfigurationError(
                "A batch has the wrong number of observed steps.",
                got=f"{STATE} with {state.shape[1]} steps",
                allowed=f"n_obs_steps={wanted}, as (B, {wanted}, {state.shape[-1]})",
                hint="LeRobotDataset(..., delta_timestamps=resolve_delta_timestamps(config, meta))",
            )

    def _check_augmentation(self, batch: dict[str, Any]) -> None:
        """Raises `ConfigurationError` if the batch's augmentation is not the configured one."""
        config = self._config
        wanted = (config.augmentation_translation or 0.0, config.augmentation_yaw or 0.0, config.augmentation_mirror)
        got = batch[SCENE_MOTION].bounds if SCENE_MOTION in batch else (0.0, 0.0, 0.0)
        if got != wanted and config.has_pose_layout:
            raise ConfigurationError(
                "The augmentation of a checkpoint cannot be changed: LeRobot loads its processor as it was saved.",
                got=f"translation, yaw, mirror = {got}, but --policy.augmentation_* say {wanted}",
                allowed="the options that the checkpoint was trained with",
                hint="leave --policy.augmentation_* out, or train from new weights",
            )

    def _check_first(self, batch: dict[str, Any], actions: Tensor) -> None:
        """Raises `ConfigurationError` if the first batch's actions (B, A) differ from the looked-up ones."""
        given = batch.get(ACTION)
        if given is None:
            return
        given = given.reshape(len(given), -1)
        if given.shape != actions.shape or not torch.allclose(given.to(actions), actions, atol=1e-3):
            raise ConfigurationError(
                "A batch does not belong to the dataset that the policy was created with.",
                got=f"actions {tuple(given.shape)} that differ from the rows of its index, {tuple(actions.shape)}",
                allowed="batches of that dataset, preprocessed with its statistics",
                hint="a new training, or --resume=true with the original dataset",
            )
        self._is_checked = True


def balanced_weights(dataset_meta: Any) -> Tensor:
    """Returns weights by task index, inverse to the tasks' numbers of trained rows; their mean over rows is 1."""
    trained, rows = trained_episodes(dataset_meta), Counter[int]()
    for episode, (tasks, length) in enumerate(
        zip(dataset_meta.episodes["tasks"], dataset_meta.episodes["length"], strict=True)
    ):
        number = int(dataset_meta.get_task_index(tasks[0]))
        rows[number] += int(length) if trained is None or episode in trained else 0
    mean = sum(rows.values()) / sum(count > 0 for count in rows.values())
    return torch.tensor([mean / rows[index] if rows[index] else 0.0 for index in range(1 + max(rows))])
