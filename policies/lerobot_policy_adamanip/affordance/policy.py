"""What the point-level policies have in common: one network, and labels that are made when a training begins."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, ClassVar

import numpy as np
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor, nn
from torch.nn import Parameter

from lerobot_adamanip.lerobot_patches.batched_reading import read_in_batches
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.mixed_precision import require_mixed_precision
from lerobot_policy_adamanip.affordance.config import AffordanceConfig
from lerobot_policy_adamanip.common.contract import LoadsStrictly, observed
from lerobot_policy_adamanip.common.demonstrations import Demonstrations, read_demonstrations
from lerobot_policy_adamanip.common.publishing import PublishesOurCard
from lerobot_policy_adamanip.common.recorded_rows import EPISODE, INDEX, RecordedRows


class Labels(nn.Module):
    """Arrays of a dataclass as tensors that go where the policy goes; no checkpoint holds them.

    Args:
        made: a dataclass of arrays, looked up by row; see `AffordancePolicy.rows_of`.
    """

    def __init__(self, made: Any) -> None:
        super().__init__()
        for item in fields(made):
            value = torch.from_numpy(np.ascontiguousarray(getattr(made, item.name)))
            self.register_buffer(item.name, value, persistent=False)


class AffordancePolicy(PublishesOurCard, LoadsStrictly, PreTrainedPolicy):
    """Base of LeRobot policies.

    Args:
        config: of which `validate_features` is called here.
        dataset_meta: of the demonstrations; their labels are made here. None where nothing is to be learnt.
        kwargs: whatever else LeRobot passes.
    """

    config_class: ClassVar[type[AffordanceConfig]] = AffordanceConfig
    name: ClassVar[str] = "affordance"

    def __init__(self, config: AffordanceConfig, *, dataset_meta: Any = None, **kwargs: Any) -> None:
        super().__init__(config)
        if config.use_amp:
            require_mixed_precision(str(config.device))
        config.validate_features()
        self.model = self.make_network()
        self._labels: Labels | None = None
        if dataset_meta is not None:
            read_in_batches(dataset_meta)
            demonstrations = read_demonstrations(dataset_meta)
            self._labels = Labels(self.make_labels(demonstrations))
            self._recorded = RecordedRows({INDEX: demonstrations.index, EPISODE: demonstrations.episode})
        self.reset()

    def make_network(self) -> nn.Module:
        """Returns the network, still untrained."""
        raise NotImplementedError

    def make_labels(self, demonstrations: Demonstrations) -> Any:
        """Returns a dataclass of arrays to learn from."""
        raise NotImplementedError

    @property
    def labels(self) -> Labels:
        """What is learnt from; raises `ConfigurationError` if the policy was made without a dataset."""
        if self._labels is None:
            raise ConfigurationError(
                f"{self.name} has nothing to learn from.",
                got="a policy made without a dataset",
                allowed="make_policy(..., ds_meta=) of a dataset",
                hint=f"lerobot-train --policy.type={self.name} --dataset.root=...",
            )
        return self._labels

    def rows_of(self, batch: dict[str, Tensor]) -> Tensor:
        """Returns the rows (B,) of `labels` that a batch holds; see `RecordedRows.rows`."""
        return self._recorded.rows(batch[INDEX])

    def get_optim_params(self) -> Any:
        """Parameters to train."""
        self.require_own_push()
        parameters: list[Parameter] = list(self.model.parameters())
        return parameters

    def observed(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Returns clouds (B, N, 3) [m] and tool poses (B, 10) of one observation."""
        return observed(self.config, batch, self.config.num_points)
