"""Refuses chunks of a policy with a history that is never told what was executed."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from lerobot.configs.policies import PreTrainedConfig
from torch import Tensor

from lerobot_adamanip.contract.schema import POINT_CLOUD, STATE
from lerobot_adamanip.util.errors import ConfigurationError


class ChunkGuard:
    """Tells a chunk that was asked for once more from one that was executed.

    `select_action` remembers the action that it returns. LeRobot's asynchronous policy server calls
    `predict_action_chunk` alone, with one observation after another, so the history would stay empty.

    Args:
        config: of the policy; without remembered steps there is nothing to guard.
    """

    def __init__(self, config: PreTrainedConfig) -> None:
        self._policy_type = config.type
        self._remembers = getattr(config, "n_action_history_steps", 1) > 0 or getattr(config, "observed_steps", 1) > 1
        self._predicted: Mapping[str, Tensor] | None = None

    def select(self) -> None:
        """Notes that `select_action` was called, so that the history goes on."""
        self._predicted = None

    def predict(self, observation: Mapping[str, Tensor]) -> None:
        """Notes a predicted chunk. The same observation may be asked again, as often as is wanted.

        Args:
            observation: cloud (B, N, 3) [m] and state (B, D).

        Raises:
            ConfigurationError: another observation was predicted from, and no action was selected since.
        """
        latest = self._predicted or observation
        if self._remembers and any(not torch.equal(latest[key], observation[key]) for key in (POINT_CLOUD, STATE)):
            raise ConfigurationError(
                f"{self._policy_type} has a history, and is not told which actions were executed.",
                got="predict_action_chunk for another observation, without select_action since the first",
                allowed="select_action for each observation; reset() where another episode begins",
                hint="lerobot-rollout --inference.type=sync, instead of rtc or the asynchronous policy server",
            )
        self._predicted = latest
