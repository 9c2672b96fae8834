"""Typical motions of demonstrations by k-means clustering, as in Behavior Transformers."""

from __future__ import annotations

import logging

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION, ACTION_DIM, STATE
from lerobot_policy_adamanip.common.geometry import MOTION_UNITS, motion_between
from lerobot_policy_adamanip.common.inputs import RecordedRows

MIN_SPREAD = (0.002, 0.002, 0.002, 0.02, 0.02, 0.02, 0.02)
"""Lower bound of a cluster's spread [m, m, m, rad, rad, rad, -]."""
STARTS = 8
"""Number of starts of k-means."""
MAX_ROWS = 10_000
"""Maximum number of motions that k-means runs on, taken at regular intervals."""
MAX_SPREADS, MAX_FAR_SHARE = 3.0, 0.1
"""A motion is far if every anchor is more than `MAX_SPREADS` spreads away; a share of far motions above `MAX_FAR_SHARE`
warns. Of the data that anchors were fitted to, 0.5 % are far; of other data of the same category, 3 %."""


def cluster_motions(motions: NDArray[np.float32], count: int) -> tuple[Tensor, Tensor]:
    """Clusters motions (M, 7) by k-means in `MOTION_UNITS`, the best of `STARTS` starts.

    With a bad start most clusters are approaches, and few are left for motions in contact.

    Returns:
        centres (count, 7) [m, rad, -] and spreads (count, 7), at least `MIN_SPREAD`. If there are fewer distinct
        motions than ``count``, some are repeated.
    """
    from scipy.cluster.vq import kmeans2, vq

    units = np.asarray(MOTION_UNITS)
    rows = motions.astype(np.float64) / units
    different = np.unique(rows.round(4), axis=0)
    if len(different) <= count:
        centres = different
    else:
        some = rows[:: -(-len(rows) // MAX_ROWS)]
        starts = [kmeans2(some, count, minit="++", iter=50, seed=seed)[0] for seed in range(STARTS)]
        centres = min(starts, key=lambda centres: np.square(vq(some, centres)[1]).mean())
    labels, _ = vq(rows, centres)
    clusters = range(len(centres))
    spread = np.stack([rows[labels == k].std(axis=0) if (labels == k).any() else 0 * units for k in clusters])
    spread = np.maximum(spread * units, np.asarray(MIN_SPREAD))
    repeated = np.arange(count) % len(centres)
    typical, spread = (part[repeated].astype(np.float32) for part in (centres * units, spread))
    return torch.from_numpy(typical), torch.from_numpy(spread)


def demonstrated_motions(recorded: RecordedRows) -> Tensor:
    """Returns the motions (M, 7) to all labels of a dataset."""
    return motion_between(recorded.labelled(ACTION), recorded.labelled(STATE)[:, :ACTION_DIM])


def warn_of_other_motions(motions: Tensor, anchors: Tensor, spread: Tensor) -> None:
    """Warns if many motions (M, 7) are far from all anchors (K, 7), which were fitted to another dataset."""
    rows = motions.to(anchors)
    nearest = torch.full((len(rows),), float("inf")).to(anchors)
    for anchor, unit in zip(anchors, spread, strict=True):
        nearest = torch.minimum(nearest, ((rows - anchor).abs() / unit).amax(dim=1))
    far = float((nearest > MAX_SPREADS).float().mean()) if len(rows) else 0.0
    if far > MAX_FAR_SHARE:
        logging.getLogger(__name__).warning(
            "%.0f %% of these demonstrations' motions are more than %g spreads from every anchor of the checkpoint. "
            "Fine-tuning keeps the anchors of the first dataset. Try training from scratch on both (adamanip merge).",
            100 * far,
            MAX_SPREADS,
        )
