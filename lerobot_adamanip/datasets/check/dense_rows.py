"""Check the rows of datasets at control rate: limits of each kind of action and state, key frames, and tries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import EE_DELTA, FINGER_TRAVEL, JOINT, POSE
from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.datasets.dense import kind_by_size
from lerobot_adamanip.hardware.backends.franky_options import JOINT_RANGES
from lerobot_adamanip.hardware.features import UNLABELLED

Columns = Mapping[str, NDArray[Any]]
Limits = tuple[NDArray[np.float64], NDArray[np.float64]]
DENSE_LABELS: Mapping[str, tuple[int, int]] = {
    schema.OUTCOME: (schema.GOES_ON, max(Outcome)), schema.DIRECTION: (-1, 1),
}  # fmt: skip
"""Column -> smallest and largest code, where they differ from those of key frames."""
MARGIN = 1e-3
"""Rounding allowance of a limit [its unit]. Measured joints and fingers may press that far into their stops."""


def check_dense_values(
    where: Rows, columns: Columns, features: Mapping[str, Mapping[str, Any]], report: Report
) -> None:
    """Checks each row alone: action and state are within the limits of their kinds, and tries have a direction."""
    for key, (lowest, highest) in _limits(features).items():
        if key in columns and columns[key].shape[1:] == lowest.shape:
            values = columns[key].astype(np.float64)
            beyond = np.asarray(((values < lowest - MARGIN) | (values > highest + MARGIN)).any(axis=1))
            kind = kind_by_size(features, key if key == schema.STATE else schema.ACTION)
            report.add_rows("limits", f"{key} is outside the limits of {kind}", where, beyond)
    if schema.TRIED in columns and schema.DIRECTION in columns:
        wrong = (columns[schema.TRIED] >= 0) != (columns[schema.DIRECTION] != 0)
        report.add_rows("label", f"{schema.DIRECTION} and {schema.TRIED} contradict each other", where, wrong)


def _limits(features: Mapping[str, Mapping[str, Any]]) -> dict[str, Limits]:
    """Returns column -> smallest and largest values, of the kinds that have limits of their own; poses have not.

    What a policy sent is as it was: the environment clips it.
    """
    limits: dict[str, Limits] = {}
    action = kind_by_size(features, schema.ACTION)
    if action == EE_DELTA:
        limits[schema.ACTION] = np.full(7, -1.0), np.ones(7)
    elif action == JOINT:
        low, high = (np.array(values) for values in JOINT_RANGES["panda"])
        limits[schema.ACTION] = np.append(low, 0.0), np.append(high, 1.0)
    if kind_by_size(features, schema.STATE) == POSE:
        turn = np.full(3, 2.0 * np.pi)
        far = np.full(3, np.inf)
        limits[schema.STATE] = np.r_[-far, -turn, 0.0, 0.0], np.r_[far, turn, FINGER_TRAVEL, FINGER_TRAVEL]
    return limits


def check_dense_course(where: Rows, first: NDArray[np.bool_], columns: Columns, report: Report) -> None:
    """Checks episodes: key frames last until their outcome, and failed tries are counted where they end.

    Rows of a robot have no key frames. ``first`` marks the first row of each episode.
    """
    last = np.r_[first[1:], True]
    if schema.OUTCOME in columns:
        ends = columns[schema.OUTCOME] != schema.GOES_ON
        report.add_rows("label", f"{schema.OUTCOME} of the final observation is not -1", where, last & ends)
        follows = ~first & ~np.r_[False, ends[:-1]]
        if schema.PHASE in columns:
            follows &= columns[schema.PHASE] != UNLABELLED
        for key in (key for key in (schema.KEY_FRAME, schema.PHASE) if key in columns):
            values = columns[key].reshape(len(where), -1)
            changed = np.r_[False, (values[1:] != values[:-1]).any(axis=1)]
            report.add_rows("label", f"{key} changes within a key frame", where, follows & changed)
    if schema.TRIAL in columns and schema.FAILED in columns:
        counted = np.diff(columns[schema.TRIAL].astype(np.int64), prepend=0)
        failed = np.r_[False, columns[schema.FAILED][:-1].astype(bool)]
        wrong = ~first & (counted > failed)
        report.add_rows("label", f"{schema.TRIAL} counts a failed try that no row before it has", where, wrong)
