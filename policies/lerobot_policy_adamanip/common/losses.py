"""Parts of training losses."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor


def valid_rows(valid: Tensor) -> Tensor:
    """Returns the indices (R,) of valid rows of (B,) bool; [0] if there are none, to be given zero weight.

    Thus every weight has a gradient in every step.
    """
    rows = valid.nonzero().squeeze(-1)
    return rows if len(rows) else rows.new_zeros(1)


def surely_none(mask: Tensor) -> bool:
    """Returns whether no element of a mask is true, as far as is known without waiting for a GPU."""
    return mask.device.type == "cpu" and not bool(mask.any())


def weighted_mean(losses: Tensor, weights: Tensor) -> Tensor:
    """Returns the mean of losses (...) with weights (...); 0 if all weights are zero."""
    return (losses * weights).sum() / weights.sum().clamp(min=1e-6)


def error_by_group(predicted: Tensor, target: Tensor, sizes: Sequence[int]) -> Tensor:
    """Returns the sum of the groups' mean absolute errors. (..., sum of sizes) each -> (...).

    All groups have the same weight, whatever their size: a grasp's offset decides whether it holds.
    """
    groups = torch.split((predicted - target).abs(), list(sizes), dim=-1)
    return torch.stack([group.mean(dim=-1) for group in groups]).sum(dim=0)


def logistic_loss(logits: Tensor, target: Tensor) -> Tensor:
    """Returns the binary cross-entropy of each logit. (...), (...) in [0, 1] -> (...)."""
    return F.binary_cross_entropy_with_logits(logits, target, reduction="none")


def sum_losses(losses: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
    """Returns the sum of the losses, and each one as a metric, with a single transfer from the device."""
    total = torch.stack(list(losses.values()))
    return total.sum(), dict(zip(losses, total.tolist(), strict=True))
