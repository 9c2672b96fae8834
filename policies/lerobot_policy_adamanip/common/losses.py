"""Parts of training losses."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor


def valid_rows(valid: Tensor) -> Tensor:
    """Returns indices (R,) of valid rows of (B,) bool; [0], to be given zero weight, if there are none.

    So every weight has a gradient in every step.
    """
    rows = valid.nonzero().squeeze(-1)
    return rows if len(rows) else rows.new_zeros(1)


def weighted_mean(losses: Tensor, weights: Tensor) -> Tensor:
    """Returns the mean of losses (...) with weights (...); 0 if all weights are zero."""
    return (losses * weights).sum() / weights.sum().clamp(min=1e-6)


def error_by_group(predicted: Tensor, target: Tensor, sizes: Sequence[int]) -> Tensor:
    """Returns the sum over groups of numbers of their mean absolute error. (..., sum of sizes) each -> (...).

    Groups count alike, however many numbers they have: a grasp's offset decides whether it holds.
    """
    groups = torch.split((predicted - target).abs(), list(sizes), dim=-1)
    return torch.stack([group.mean(dim=-1) for group in groups]).sum(dim=0)


def logistic_loss(logits: Tensor, target: Tensor) -> Tensor:
    """Binary cross-entropy of each logit. (...), (...) in [0, 1] -> (...)."""
    return F.binary_cross_entropy_with_logits(logits, target, reduction="none")


def sum_losses(losses: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
    """Returns the sum of losses, and each as a metric, with one transfer from the device."""
    total = torch.stack(list(losses.values()))
    return total.sum(), dict(zip(losses, total.tolist(), strict=True))
