"""Convert recordings of the former format, whose ``observation.state`` holds a clock and the result, in place."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, POSE, STATES
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.datasets.dataset import STATS
from lerobot_adamanip.datasets.opening import INFO, read_info
from lerobot_adamanip.datasets.output_folder import lock_output
from lerobot_adamanip.datasets.repair import Repair
from lerobot_adamanip.datasets.statistics import PICTURES, compute_statistics, write_episodes, write_statistics
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.dense_kinds import encode_action, state_of
from lerobot_adamanip.hardware.features import (
    ARM,
    ARM_NAMES,
    FORMER_LABEL,
    SENT_NAMES,
    STAMP_NAME,
    is_former,
    names_of,
    recorded_features,
)
from lerobot_adamanip.hardware.recorded_rows import recorded_row
from lerobot_adamanip.util import files
from lerobot_adamanip.util.arrow import numeric_array

Columns = dict[str, NDArray[Any]]
Statistics = dict[int, dict[str, dict[str, Any]]]
"""Episode -> column -> statistic -> values."""


def convert_former(done: Repair) -> None:
    """Converts a recording to the present format: state ``pose``, action ``ee_delta``, the rest in other columns.

    Each file is replaced in one step, ``meta/info.json`` last, so a conversion that was killed can be repeated. The
    originals are copied to the backup. Does nothing to other datasets.
    """
    former = read_info(done.root)
    if not is_former(former["features"]):
        return
    with lock_output(done.root, optional=True):
        names = {schema.STATE: STATES[POSE], schema.ACTION: ACTION_NAMES[EE_DELTA]}
        kinds = {key: {"dtype": "float32", "shape": (len(own),), "names": list(own)} for key, own in names.items()}
        features = recorded_features({**former["features"], **kinds})
        features = {key: {**feature, "shape": tuple(feature["shape"])} for key, feature in features.items()}
        numeric = {key: feature for key, feature in features.items() if feature["dtype"] not in PICTURES}
        statistics: Statistics = {}
        for path in sorted(done.root.glob("data/*/*.parquet")):
            statistics |= _convert_rows(done, path, former["features"], numeric)
        for path in sorted(done.root.glob("meta/episodes/*/*.parquet")):
            done.back_up(path)
            write_episodes(path, _with_statistics(pq.read_table(path), statistics, numeric))
        plain = {key: {**feature, "shape": list(feature["shape"])} for key, feature in features.items()}
        done.back_up(done.root / STATS)
        write_statistics(done.root, features)
        done.replace(done.root / INFO, {**former, "features": plain}, "converted from the former format")


def _convert_rows(
    done: Repair, path: Path, former: Mapping[str, Any], features: Mapping[str, Mapping[str, Any]]
) -> Statistics:
    """Converts a data file, unless it is converted already. Returns the statistics of its episodes."""
    import datasets
    from lerobot.datasets.feature_utils import get_hf_features_from_features

    table = pq.read_table(path).replace_schema_metadata(None)
    types, numbers = get_hf_features_from_features(dict(features)), np.asarray(table["episode_index"])
    statistics: Statistics = {}
    sink = pa.BufferOutputStream()
    with contextlib.ExitStack() as stack:
        writer = None
        for number in dict.fromkeys(numbers.tolist()):
            rows = table.filter(pa.array(numbers == number))
            columns = {key: values for key in rows.column_names if (values := numeric_array(rows[key])) is not None}
            columns |= {} if ARM in columns else _converted(columns, former)
            flat = {key: columns[key][:, 0] if columns[key].shape[1:] == (1,) else columns[key] for key in features}
            statistics[number] = compute_statistics(flat, features)
            part = datasets.Dataset.from_dict(flat, features=types).with_format("arrow")[:]
            if writer is None:
                writer = stack.enter_context(pq.ParquetWriter(sink, part.schema, compression="snappy"))
            writer.write_table(part)  # an episode is a row group
    if ARM not in table.column_names:
        done.back_up(path)
        files.write_atomically(path, sink.getvalue().to_pybytes())
    return statistics


def _converted(columns: Mapping[str, Any], former: Mapping[str, Any]) -> Columns:
    """Returns the columns (T, ...) of an episode that differ from the former ones."""
    state_names, action_names = (names_of(former[key]) for key in (schema.STATE, schema.ACTION))
    arm = columns[schema.STATE][:, [state_names.index(name) for name in ARM_NAMES]].astype(np.float32)
    asked = columns[schema.ACTION][:, [action_names.index(name) for name in schema.POSE_NAMES]].astype(np.float32)
    success = columns[schema.STATE][:, state_names.index(FORMER_LABEL)] > 0.5
    sent = arm[:, [ARM_NAMES.index(name) for name in SENT_NAMES]]
    accepted = np.concatenate([sent[1:], asked[-1:]])  # a row's target is reported by the next row
    rows = [_row(*values) for values in zip(arm, asked, accepted, strict=True)]
    stacked = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    return stacked | {
        ARM: arm,
        schema.SUCCESS: np.append(success[1:], success[-1:])[:, None],
        schema.DONE: np.arange(len(arm))[:, None] == len(arm) - 1,
    }


def _row(arm: NDArray[np.float32], asked: NDArray[np.float32], accepted: NDArray[np.float32]) -> Columns:
    """Returns a row's columns from its reading, its requested target (10,) and its accepted target (10,)."""
    pose, gripper = pose_from_vector(arm[: schema.ACTION_DIM])
    qpos, qvel, effort = np.split(arm[schema.ACTION_DIM : schema.STATE_DIM + schema.NUM_JOINTS].astype(np.float64), 3)
    stamp = float(arm[ARM_NAMES.index(STAMP_NAME)])
    reading = ArmReading(stamp, stamp, pose, gripper, qpos, qvel, effort, ArmMode.IDLE)
    action = encode_action(EE_DELTA, asked, reading)
    return {
        **recorded_row(EE_DELTA, reading, accepted, stamp),
        schema.STATE: state_of(POSE, reading),
        schema.ACTION: np.array(list(action.values()), np.float32),
    }


def _with_statistics(table: pa.Table, statistics: Statistics, features: Mapping[str, Any]) -> pa.Table:
    """Returns rows of ``meta/episodes`` with the statistics of these columns replaced."""
    prefixes = tuple(f"stats/{key}/" for key in features)
    table = table.select([name for name in table.column_names if not name.startswith(prefixes)])
    episodes = [statistics[number] for number in table["episode_index"].to_pylist()]
    for key in features:
        for name in episodes[0][key]:
            values = [np.atleast_1d(episode[key][name]).tolist() for episode in episodes]
            table = table.append_column(f"stats/{key}/{name}", pa.array(values))
    return table
