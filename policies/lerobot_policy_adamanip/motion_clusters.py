"""The typical ones of demonstrated motions: k-means clusters, as Behavior Transformers have them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.schema import ACTION, ACTION_DIM, STATE
from lerobot_policy_adamanip.demonstrations import read_columns
from lerobot_policy_adamanip.tool_frame import MOTION_UNITS, motion_between

LEAST_SPREAD = (0.002, 0.002, 0.002, 0.02, 0.02, 0.02, 0.02)
"""Spread of a cluster that counts as none [m, m, m, rad, rad, rad, -]: finer than this is not asked for."""


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
    """Returns the motions (M, 7) of a dataset, from its files: see `read_columns`."""
    columns = read_columns(dataset_meta, (STATE, ACTION))
    poses, actions = (torch.from_numpy(columns[key]) for key in (STATE, ACTION))
    motions: NDArray[np.float32] = motion_between(actions, poses[:, :ACTION_DIM]).numpy()
    return motions
