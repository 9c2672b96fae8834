"""Check values of rows: finite, right shape, orthonormal rotations, clouds in the workspace, known labels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome, Phase
from lerobot_adamanip.contract.pointcloud import Workspace, as_points
from lerobot_adamanip.datasets.check.findings import Report, Rows
from lerobot_adamanip.hardware.features import UNLABELLED
from lerobot_adamanip.util.arrow import numeric_array

Columns = dict[str, NDArray[Any]]
"""Column -> (R, ...) values."""
ORTHONORMAL = 1e-3
"""Largest deviation of rotation rows from length 1, and of their product from 0."""
MARGIN = 1e-4
"""Rounding allowance for points outside the workspace [m] and openings outside [0, 1]."""
LABELS: Mapping[str, tuple[int, int]] = {
    schema.PHASE: (UNLABELLED, max(Phase)), schema.OUTCOME: (min(Outcome), max(Outcome)),
    schema.TRIED: (-1, schema.MAX_OBJECT_JOINTS - 1), schema.TRIAL: (UNLABELLED, 10_000),
}  # fmt: skip
"""Column -> smallest and largest code."""


def check_values(
    where: Rows, table: pa.Table, features: Mapping[str, Mapping[str, Any]], workspace: Workspace, report: Report
) -> Columns:
    """Checks rows; returns the columns whose cells all have the right shape."""
    columns: Columns = {}
    for key, feature in features.items():
        if feature["dtype"] in ("video", "image", "string", "language"):
            continue
        values = numeric_array(table[key])
        shape = tuple(feature["shape"])
        shape = () if shape == (1,) else shape
        if values is None or values.shape[1:] != shape:
            _report_shape(where, table, key, shape, report)
            continue
        columns[key] = values
        if values.dtype.kind == "f":
            broken = ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
            report.add_rows("not-finite", f"NaN or infinity in {key}", where, broken)
    with np.errstate(invalid="ignore"):
        _check_poses(where, columns, report)
        _check_clouds(where, columns, workspace, report)
    _check_labels(where, columns, report)
    return columns


def _report_shape(where: Rows, table: pa.Table, key: str, shape: tuple[int, ...], report: Report) -> None:
    chunks = [chunk.storage if isinstance(chunk, pa.ExtensionArray) else chunk for chunk in table[key].chunks]
    shapes = [_shape(cell) for chunk in chunks for cell in chunk.to_pylist()]
    wrong = np.array([each != shape for each in shapes])
    wrong[0] |= not wrong.any()  # cells without a shape
    told = sorted({str(each) for each, bad in zip(shapes, wrong.tolist(), strict=True) if bad})
    report.add_rows("shape", f"{key} has cells of shape {', '.join(told[:3])}, not {shape}", where, wrong)


def _shape(cell: Any) -> tuple[int, ...] | None:
    """Returns the shape of nested lists; None for an empty cell, or for lists of unequal lengths."""
    try:
        return None if cell is None else np.shape(cell)
    except ValueError:
        return None


def _check_poses(where: Rows, columns: Columns, report: Report) -> None:
    for key in (key for key in (schema.STATE, schema.ACTION) if key in columns):
        values = columns[key].astype(np.float64)
        finite = np.isfinite(values).all(axis=1)
        rows = values[:, schema.ROTATION_DIMS].reshape(-1, 2, 3)
        stretched = np.abs(np.linalg.norm(rows, axis=2) - 1.0).max(axis=1)
        slanted = np.abs((rows[:, 0] * rows[:, 1]).sum(axis=1))
        off = finite & (np.maximum(stretched, slanted) > ORTHONORMAL)
        report.add_rows("rotation", f"rotation 6D of {key} is not orthonormal", where, off)
        opening = values[:, schema.GRIPPER_DIM]
        beyond = finite & ((opening < -MARGIN) | (opening > 1.0 + MARGIN))
        report.add_rows("gripper", f"gripper of {key} is not in [0, 1]", where, beyond)


def _check_clouds(where: Rows, columns: Columns, workspace: Workspace, report: Report) -> None:
    if schema.POINT_CLOUD not in columns or columns[schema.POINT_CLOUD].shape[-1] % 3:
        return
    clouds = as_points(columns[schema.POINT_CLOUD])
    lowest, highest = clouds.min(axis=1), clouds.max(axis=1)
    beyond = (lowest < np.array(workspace.lower) - MARGIN) | (highest > np.array(workspace.upper) + MARGIN)
    # A camera that sees nothing gives zeros: see `pointcloud.farthest_point_order`.
    nothing = ((lowest == 0.0) & (highest == 0.0)).all(axis=1)
    finite = np.isfinite(lowest + highest).all(axis=1)
    box = f"{tuple(workspace.lower)} to {tuple(workspace.upper)}"
    report.add_rows("workspace", f"points outside {box} m", where, finite & beyond.any(axis=1) & ~nothing)


def _check_labels(where: Rows, columns: Columns, report: Report) -> None:
    for key, (least, most) in LABELS.items():
        if key in columns:
            wrong = (columns[key] < least) | (columns[key] > most)
            report.add_rows("label", f"{key} is not in {least} ... {most}", where, wrong)
    if schema.TRIED in columns and schema.FAILED in columns:
        wrong = columns[schema.FAILED].astype(bool) & (columns[schema.TRIED] < 0)
        report.add_rows("label", f"{schema.FAILED} without a try", where, wrong)
