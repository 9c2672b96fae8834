"""AdamW in one kernel for all weights, which LeRobot's own option cannot ask torch for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import torch
from lerobot.optim.optimizers import AdamWConfig, OptimizerConfig
from torch.nn import Parameter

FUSED_DEVICES = ("cpu", "cuda")
"""Kinds of devices for which torch has had the kernel since long."""


@OptimizerConfig.register_subclass("fused_adamw")
@dataclass
class FusedAdamWConfig(AdamWConfig):
    """AdamW with LeRobot's options. The same numbers up to rounding."""

    def build(self, params: Iterable[Parameter] | Iterable[dict[str, Any]]) -> torch.optim.AdamW:
        """Returns the optimizer of parameters or of groups of them; where torch has no such kernel, its plain one.

        Sets `torch.set_flush_denormal` for the whole process.
        """
        groups: list[Any] = list(params)
        values = asdict(self)
        values.pop("grad_clip_norm")
        # The averages of gradients that have become zero shrink for ever, after 2,400 steps a tenth of them below the
        # range of float32, where a processor needs many times as long for each and no weight is moved any more.
        torch.set_flush_denormal(True)
        kinds = {weight.device.type for group in groups for weight in _weights(group)}
        return torch.optim.AdamW(groups, **values, fused=kinds <= set(FUSED_DEVICES))


def _weights(group: Parameter | dict[str, Any]) -> list[Parameter]:
    return list(group["params"]) if isinstance(group, dict) else [group]
