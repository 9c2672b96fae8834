"""Windows of a training batch: the batch holds the present row, the rest is looked up by its ``index``."""

from __future__ import annotations

from typing import Any

import torch
from lerobot.lerobot_types import TransitionKey
from lerobot.processor import NormalizerProcessorStep, create_transition
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION, EXECUTED, STATE
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.demonstrations import IS_LABEL, read_recorded_rows
from lerobot_policy_adamanip.common.recorded_rows import INDEX
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.scene_motion import SCENE_MOTION
from lerobot_policy_adamanip.dp3_adaptive.window import Window


class TrainingWindows:
    """A dataset's states, labels and executed actions, as the inputs and targets of a head.

    Args:
        config: of the policy.
        dataset_meta: of the dataset, whose files are beside it; its ``stats`` are those that normalise batches.

    Raises:
        ConfigurationError: the files are not there, or lack a column.
    """

    def __init__(self, config: DP3AdaptiveConfig, dataset_meta: Any) -> None:
        self._config, self._recorded = config, read_recorded_rows(dataset_meta)
        assert config.input_features is not None
        assert config.action_feature is not None
        features = {STATE: config.input_features[STATE], ACTION: config.action_feature}
        self._normalize = NormalizerProcessorStep(features, config.normalization_mapping, dataset_meta.stats)
        self._is_checked = False

    def of(self, batch: dict[str, Any], observations: dict[str, Tensor]) -> tuple[Window, Tensor, Tensor]:
        """Returns inputs, labels (B, T, A), and which labels are to be learnt (B, T).

        Past actions are those that were executed. Where a policy drove, the labels tell what to do better.

        Args:
            batch: preprocessed, with ``index`` (B,).
            observations: of the batch, (B, ...) of the present, or (B, S, ...) of S = n_obs_steps.

        Raises:
            ConfigurationError: the batch is of another dataset.
        """
        config, recorded = self._config, self._recorded
        if observations[STATE].dim() == 2:
            observations = {key: value[:, None] for key, value in observations.items()}
        past, rows = config.n_action_history_steps, recorded.rows(batch[INDEX])
        before, valid = recorded.around(rows, range(-past, 0))
        ahead, exists = recorded.around(rows, range(config.horizon))
        actions = torch.cat([recorded.column(EXECUTED, before), recorded.column(ACTION, ahead)], dim=1)
        actions = self._as_in(batch, ACTION, actions)
        self._check_once(batch, actions[:, past])
        if config.observed_steps > config.n_obs_steps:
            states = self._as_in(batch, STATE, recorded.column(STATE, before))
            observations = {**observations, STATE: torch.cat([states, observations[STATE]], dim=1)}
        window = Window(observations, actions[:, :past], valid)
        return window, actions[:, past:], exists & recorded.column(IS_LABEL, ahead)

    def _as_in(self, batch: dict[str, Any], key: str, recorded: Tensor) -> Tensor:
        """Returns recorded actions or states (B, T, D) as preprocessing has made the batch's: moved, normalised."""
        moved = batch[SCENE_MOTION].poses(recorded) if SCENE_MOTION in batch else recorded
        plain = create_transition(action=moved) if key == ACTION else create_transition(observation={STATE: moved})
        done = self._normalize(plain)
        result: Tensor = done[TransitionKey.ACTION] if key == ACTION else done[TransitionKey.OBSERVATION][STATE]
        return result

    def _check_once(self, batch: dict[str, Any], actions: Tensor) -> None:
        """Compares the first batch's actions (B, A) with what was looked up for it."""
        given = batch.get(ACTION)
        if self._is_checked or given is None:
            return
        given = given.reshape(len(given), -1)
        if given.shape != actions.shape or not torch.allclose(given.to(actions), actions, atol=1e-3):
            raise ConfigurationError(
                "A batch does not belong to the dataset that the policy was made with.",
                got=f"actions {tuple(given.shape)} unlike those of the rows of its index, {tuple(actions.shape)}",
                allowed="batches of that dataset, preprocessed with its statistics",
                hint="a training from the start, or --resume=true with the dataset it began with",
            )
        self._is_checked = True
