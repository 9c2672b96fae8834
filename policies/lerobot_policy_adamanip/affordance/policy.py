"""Base of the point-level policies: one network, and labels that are computed when training starts."""

from dataclasses import fields
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from lerobot_adamanip.lerobot_patches.batched_reading import read_in_batches
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.affordance.config import AffordanceConfig
from lerobot_policy_adamanip.affordance.demonstrations import Demonstrations, read_demonstrations
from lerobot_policy_adamanip.common.inputs import EPISODE, INDEX, RecordedRows
from lerobot_policy_adamanip.common.policy import CloudPolicy


class Labels(nn.Module):
    """Arrays of a dataclass as tensors that follow the policy's device; not saved in checkpoints."""

    def __init__(self, arrays: Any) -> None:
        super().__init__()
        for item in fields(arrays):
            value = torch.from_numpy(np.ascontiguousarray(getattr(arrays, item.name)))
            self.register_buffer(item.name, value, persistent=False)


class AffordancePolicy(CloudPolicy):
    """Base of LeRobot policies. Training computes labels from the files of ``dataset_meta``; inference needs none.

    `forward` needs ``observation.point_cloud`` (B, N, 3) [m], ``observation.state`` (B, D) and ``index`` (B,);
    `select_action` needs the first two, of one observation.
    """

    network_class: ClassVar[Any]
    name: ClassVar[str] = "affordance"

    def __init__(self, config: AffordanceConfig, *, dataset_meta: Any = None, **kwargs: Any) -> None:
        super().__init__(config)
        self.model = self.network_class(config)
        self._labels: Labels | None = None
        if dataset_meta is not None:
            read_in_batches(dataset_meta)
            is_trained = config.pretrained_path is not None
            self.match_clouds(dataset_meta, is_trained=is_trained)
            self.match_control(dataset_meta, is_trained=is_trained)
            demonstrations = read_demonstrations(dataset_meta)
            self._labels = Labels(self.make_labels(demonstrations))
            self._recorded = RecordedRows({INDEX: demonstrations.index, EPISODE: demonstrations.episode})
        self.reset()

    def make_labels(self, demonstrations: Demonstrations) -> Any:
        """Returns a dataclass of arrays to learn from."""
        raise NotImplementedError

    @property
    def labels(self) -> Labels:
        """Labels of the demonstrations; raises `ConfigurationError` if the policy was created without a dataset."""
        if self._labels is None:
            raise ConfigurationError(
                f"{self.name} has nothing to learn from.",
                got="a policy created without a dataset",
                allowed="make_policy(..., ds_meta=) of a dataset",
                hint=f"lerobot-train --policy.type={self.name} --dataset.root=...",
            )
        return self._labels

    def rows_of(self, batch: dict[str, Tensor]) -> Tensor:
        """Returns the rows (B,) of `labels` that belong to a batch."""
        return self._recorded.rows(batch[INDEX])
