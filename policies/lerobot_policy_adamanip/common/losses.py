"""Parts of training losses: rows that count, means with weights, sums."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor


def counting_rows(counts: Tensor) -> Tensor:
    """Returns the indices (R,) of the rows of (B,) bool that count; the first stands in, for nothing, if none does.

    So every weight has a gradient in every step.
    """
    rows = counts.nonzero().squeeze(-1)
    return rows if len(rows) else rows.new_zeros(1)


def weighted_mean(losses: Tensor, weights: Tensor) -> Tensor:
    """Returns the mean of losses (...) with weights (...); 0 where no weight is."""
    return (losses * weights).sum() / weights.sum().clamp(min=1e-6)


def error_by_group(found: Tensor, wanted: Tensor, sizes: Sequence[int]) -> Tensor:
    """Returns the sum over groups of numbers of their mean absolute error. (..., sum of sizes) each -> (...).

    Each group counts alike: the three numbers of a grasp's offset decide whether it holds, however many there are of
    what comes after it.
    """
    groups = torch.split((found - wanted).abs(), list(sizes), dim=-1)
    return torch.stack([group.mean(dim=-1) for group in groups]).sum(dim=0)


def logistic_loss(logits: Tensor, wanted: Tensor) -> Tensor:
    """Binary cross-entropy of each logit. (...), (...) in [0, 1] -> (...)."""
    return F.binary_cross_entropy_with_logits(logits, wanted, reduction="none")


def summed(losses: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
    """Returns the sum of losses, and each as a number, as `forward` has to: one wait for the device for all of them."""
    total = torch.stack(list(losses.values()))
    return total.sum(), dict(zip(losses, total.tolist(), strict=True))
