"""The typical ones of demonstrated motions: k-means clusters, as Behavior Transformers have them."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION, ACTION_DIM, STATE
from lerobot_policy_adamanip.common.demonstrations import has_files, read_columns, unfinished_ends
from lerobot_policy_adamanip.common.tool_frame import MOTION_UNITS, motion_between

LEAST_SPREAD = (0.002, 0.002, 0.002, 0.02, 0.02, 0.02, 0.02)
"""Spread of a cluster that counts as none [m, m, m, rad, rad, rad, -]: finer than this is not asked for."""

FAR_SPREADS, MANY = 3.0, 0.1
"""A motion farther than this from every anchor, in units of the anchor's spread, is of another kind; from this share of
such motions on, a warning is due. Of the demonstrations that anchors were made from it is 0.5 %, of others 3 %.
"""


def cluster_motions(motions: NDArray[np.float32], count: int, *, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Clusters motions by k-means in their units.

    Args:
        motions: (M, 7) of the demonstrations.
        count: of clusters; with fewer different motions some stand twice.
        seed: of the clustering.

    Returns:
        centres (count, 7) [m, rad, -] and the spread of each cluster (count, 7), bounded below.
    """
    from scipy.cluster.vq import kmeans2

    units, least = np.asarray(MOTION_UNITS), np.asarray(LEAST_SPREAD)
    rows = motions.astype(np.float64) / units
    different = np.unique(rows.round(4), axis=0)
    starts = different if len(different) <= count else count
    centres, labels = kmeans2(rows, starts, minit="matrix" if starts is different else "++", iter=50, seed=seed)
    counted = range(len(centres))
    spread = np.stack([rows[labels == k].std(axis=0) if (labels == k).any() else 0 * units for k in counted])
    spread = np.maximum(spread * units, least)
    again = np.arange(count) % len(centres)
    typical, spread = (part[again].astype(np.float32) for part in (centres * units, spread))
    return torch.from_numpy(typical), torch.from_numpy(spread)


def demonstrated_motions(dataset_meta: Any) -> NDArray[np.float32]:
    """Returns the motions (M, 7) of a dataset, from its files: see `read_columns`. `unfinished_ends` show none."""
    columns = read_columns(dataset_meta, (STATE, ACTION, "index"))
    shown = ~np.isin(columns["index"].reshape(-1), unfinished_ends(dataset_meta))
    poses, actions = (torch.from_numpy(columns[key][shown]) for key in (STATE, ACTION))
    motions: NDArray[np.float32] = motion_between(actions, poses[:, :ACTION_DIM]).numpy()
    return motions


def far_share(motions: NDArray[np.float32], anchors: Tensor, spread: Tensor) -> float:
    """Returns the share of motions (M, 7) that are farther than `FAR_SPREADS` from every anchor (K, 7), in any unit."""
    rows = torch.from_numpy(motions).to(anchors)
    nearest = torch.full((len(rows),), float("inf")).to(anchors)
    for anchor, unit in zip(anchors, spread, strict=True):
        nearest = torch.minimum(nearest, ((rows - anchor).abs() / unit).amax(dim=1))
    return float((nearest > FAR_SPREADS).float().mean()) if len(rows) else 0.0


def warn_of_other_motions(dataset_meta: Any, anchors: Tensor, spread: Tensor) -> None:
    """Warns if many motions of a dataset are of another kind than those that anchors were made from."""
    share = far_share(demonstrated_motions(dataset_meta), anchors, spread) if has_files(dataset_meta) else 0.0
    if share > MANY:
        logging.getLogger(__name__).warning(
            "%.0f %% of these demonstrations' motions are more than %g spreads from every anchor of the checkpoint. "
            "Fine-tuning keeps the anchors of the first dataset. Try training from scratch on both (adamanip merge).",
            100 * share,
            FAR_SPREADS,
        )
