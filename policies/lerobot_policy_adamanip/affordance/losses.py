"""Parts of training losses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from lerobot_adamanip.util.errors import require_choice

Weighted = tuple[Tensor, Tensor]
"""Losses (R,) of some rows of a batch, and their weights (R,)."""


def valid_rows(valid: Tensor) -> Tensor:
    """Returns the indices (R,) of valid rows of (B,) bool; [0] if there are none.

    The caller gives row 0 zero weight then. So every weight of the network has a gradient in every step.
    """
    rows = valid.nonzero().squeeze(-1)
    return rows if len(rows) else rows.new_zeros(1)


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


def free_bits(divergence: Tensor, weights: Tensor, least: float) -> Tensor:
    """Returns divergences (R,) whose weighted mean is at least ``least``; without a gradient if it was below."""
    return torch.where(weighted_mean(divergence, weights) > least, divergence, least)


def sum_losses(
    losses: Mapping[str, Weighted], rows: Tensor, batch_size: int, reduction: str
) -> tuple[Tensor, dict[str, float]]:
    """Returns the sum of the losses' weighted means, and each mean as a metric, with one transfer from the device.

    With the reduction ``none``, returns a loss per sample (B,) and no metrics. Its mean is that sum; a sample without
    weight has 0.

    Args:
        losses: losses of the rows.
        rows: (R,) their indices in the batch, without repetition.
        batch_size: B.
        reduction: ``mean`` or ``none``.
    """
    if require_choice("reduction", reduction, ("mean", "none")) == "none":
        shares = [loss * weights / weights.sum().clamp(min=1e-6) for loss, weights in losses.values()]
        each = batch_size * torch.stack(shares).sum(dim=0)
        return each.new_zeros(batch_size).index_add(0, rows, each), {}
    total = torch.stack([weighted_mean(*loss) for loss in losses.values()])
    return total.sum(), dict(zip(losses, total.tolist(), strict=True))
