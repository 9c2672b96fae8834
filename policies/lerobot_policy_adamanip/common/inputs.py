"""Inputs of policies: the observation of a batch, and recorded rows looked up by the batch's ``index``.

LeRobot's readers return observations, actions and a row's ``index``. ``resolve_delta_timestamps`` makes windows of
``action``, ``next.reward`` and all of ``observation.*``. It cannot make windows of executed actions, or of states
without clouds. Its batches lack ``next.success`` and ``complementary_info.*`` after preprocessing. So policies read
only the present row from LeRobot, and look up the rest.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.contract.schema import ACTION, ACTION_DIM, DONE, EXECUTED, GOES_ON, OUTCOME, POINT_CLOUD, STATE
from lerobot_adamanip.util.arrow import episode_bounds, numeric_array
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common import strokes
from lerobot_policy_adamanip.common.config import CloudPolicyConfig, wrong_number_of_points

_logger = logging.getLogger(__name__)
INDEX, EPISODE = "index", "episode_index"
IS_LABEL = "is_label"
"""Column of `read_recorded_rows`: whether a row's action is a training label."""
DEPARTS = "departs"
"""Column of `read_recorded_rows`: whether a key frame ends with the row in which something else was sent than its
label, a mistake or a policy's action. Later rows answer a state that the labels before do not lead to."""
SAME_ACTION = 0.02
"""Actions are the same if no number differs by more [m, rotation 6D, opening; shares of a delta]."""
IS_TRAINED = "is_trained"
"""Column of `read_recorded_rows`: whether a row's episode is trained on."""
STROKE = "stroke"
"""Column of `read_recorded_rows`: number of the stroke that a dense step is part of, counted over all episodes."""
_POSITION, _FIRST, _LAST = "position of an index", "first row of the episode", "last row of the episode"


def pick_inputs(config: CloudPolicyConfig, batch: Mapping[str, Any]) -> dict[str, Tensor]:
    """Returns a policy's inputs, clouds cropped to (..., N, 3); raises `ConfigurationError` if one is missing."""
    features = config.input_features or {}
    if any(batch.get(key) is None for key in features):
        raise ConfigurationError(
            "The observation lacks an input of the policy.",
            got=", ".join(key for key in batch if key.startswith("observation")) or "no observation",
            allowed=", ".join(features),
            hint="--env.type=adamanip_safe, or another environment with point clouds",
        )
    inputs: dict[str, Tensor] = {key: batch[key] for key in features}
    cloud = inputs[POINT_CLOUD]
    if cloud.shape[-1] != features[POINT_CLOUD].shape[-1]:  # 3 N numbers, as in datasets
        cloud = cloud.reshape(*cloud.shape[:-1], -1, 3)
    if cloud.shape[-2] < config.num_points:
        raise wrong_number_of_points(cloud.shape[-2:], config.num_points)
    inputs[POINT_CLOUD] = cloud[..., : config.num_points, :3]
    return inputs


@dataclass(frozen=True)
class Window:
    """Inputs of a head, normalised, with S observed steps and H remembered actions.

    Attributes:
        observations: cloud (B, S or 1, N, 3) [m], state (B, S, D), effort (B, S, 7) if used; the last is the present.
            The instruction (B, S or 1, 64) if used.
        history: (B, H, A) actions, oldest first. Rows before an episode's start hold the *label*, so they must be
            masked, in training and at run time.
        valid: (B, H) bool.
    """

    observations: dict[str, Tensor]
    history: Tensor
    valid: Tensor


def trained_episodes(dataset_meta: Any) -> list[int] | None:
    """Returns the episodes of the dataset that owns these metadata; None for all.

    LeRobot gives a policy the metadata of all episodes. The dataset object alone knows `--dataset.episodes` and
    `--dataset.eval_split`, so this looks for it among the objects of the process.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset

    for owner in gc.get_objects():
        if (
            issubclass(type(owner), (LeRobotDataset, StreamingLeRobotDataset))
            and vars(owner).get("meta") is dataset_meta
        ):
            episodes: list[int] | None = owner.episodes
            return episodes
    _logger.warning(
        "No dataset in this process has these metadata, so all of its episodes count as trained on. If some are held "
        "out, create the policy with the metadata of the dataset itself, `dataset.meta`."
    )
    return None


def is_trained(dataset_meta: Any, episode: NDArray[Any]) -> NDArray[np.bool_]:
    """Returns whether rows (R,) of these episodes are trained on."""
    trained = trained_episodes(dataset_meta)
    return np.ones(len(episode), np.bool_) if trained is None else np.isin(episode, trained)


def read_columns(dataset_meta: Any, keys: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Returns numeric columns of a dataset, ordered by `INDEX`: key -> (rows, ...), floats as float32.

    Raises `ConfigurationError` if the files or a column are missing.
    """
    import pyarrow.dataset as files

    folder = Path(dataset_meta.root) / "data"
    if not folder.is_dir():
        raise ConfigurationError(
            "The demonstrations' columns cannot be read.",
            got=f"no folder {folder.name} beside the metadata",
            allowed="a dataset whose files have been downloaded",
            hint="--dataset.streaming=false; in Python, LeRobotDataset(repo_id) before the policy is created",
        )
    source, keys = files.dataset(folder, format="parquet"), list(keys)
    missing = [key for key in keys if key not in source.schema.names]
    if missing:
        raise ConfigurationError(
            "The demonstrations lack columns that labels are computed from.",
            got=f"no {', '.join(missing)}",
            allowed="the columns of this project's contract, see docs/dataset_columns.md",
            hint="adamanip collect DIR --category safe",
        )
    table = source.to_table(columns=sorted({*keys, INDEX})).sort_by(INDEX)
    columns = {}
    for key in keys:
        values = numeric_array(table[key])
        column = np.stack(table[key].to_numpy()) if values is None else values
        columns[key] = column.astype(np.float32) if column.dtype.kind == "f" else column
    return columns


class RecordedRows:
    """Narrow columns, key -> (R, ...), with rows ordered by `INDEX`; `INDEX` and `EPISODE` are among them.

    Contains all downloaded episodes, also held-out ones. The first look-up from a new device copies the columns there.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        index, episode = (columns[key].reshape(-1) for key in (INDEX, EPISODE))
        position = np.full(int(index.max(initial=-1)) + 2, -1, np.int64)
        position[index] = np.arange(len(index))
        first, last = episode_bounds(episode)
        arrays = {**columns, _POSITION: position, _FIRST: first, _LAST: last}
        self._tensors = {torch.device("cpu"): {key: torch.from_numpy(np.array(array)) for key, array in arrays.items()}}

    def rows(self, index: Tensor) -> Tensor:
        """Returns the positions (B,) of rows with an ``index`` (B,) or (B, 1).

        Raises `ConfigurationError` for an unknown row, except on a GPU, where the check would synchronise.
        """
        index = index.reshape(-1)
        position = self._on(index.device)[_POSITION]
        rows = position[index.clamp(max=len(position) - 1)]
        if rows.device.type == "cpu" and (rows < 0).any():
            raise ConfigurationError(
                "A batch contains rows of another dataset.",
                got=f"index {int(index[rows < 0][0])} of a dataset of {int((position >= 0).sum())} rows",
                allowed="batches of the dataset that the policy was created with",
                hint="make_policy(config, ds_meta=dataset.meta)",
            )
        return rows

    def column(self, key: str, rows: Tensor) -> Tensor:
        """Returns a column (..., D) at rows (...)."""
        return self._on(rows.device)[key][rows]

    def labelled(self, key: str) -> Tensor:
        """Returns a column (M, D), on the CPU, at the rows that are trained on and whose action is a label."""
        columns = self._on(torch.device("cpu"))
        return columns[key][columns[IS_LABEL] & columns[IS_TRAINED]]

    def around(self, rows: Tensor, steps: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Returns rows (B, T) at steps relative to rows (B,), and whether they exist in the same episode (B, T).

        Rows beyond an episode's end are clamped to it, as in LeRobot's windows.
        """
        tensors = self._on(rows.device)
        shifted = rows[:, None] + torch.as_tensor(steps, dtype=rows.dtype, device=rows.device)
        first, last = (tensors[key][rows, None] for key in (_FIRST, _LAST))
        return shifted.clamp(first, last), (shifted >= first) & (shifted <= last)

    def strokes(self, rows: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """Returns the first and last rows, and validity, each (B, count), of the strokes before rows (B,).

        The latest stroke ends at the row before, though it may go on.
        """
        tensors = self._on(rows.device)
        first, before = tensors[_FIRST][rows], rows - 1
        latest = torch.where(before >= first, tensors[STROKE][before.clamp(min=0)], tensors[STROKE][first] - 1)
        number, start, end = strokes.stroke_bounds(tensors[STROKE], latest, count)
        end = torch.minimum(end, before[:, None])
        return start.maximum(first[:, None]), end.maximum(first[:, None]), number >= tensors[STROKE][first, None]

    def _on(self, device: torch.device) -> dict[str, Tensor]:
        if device not in self._tensors:
            source = next(iter(self._tensors.values()))
            self._tensors[device] = {key: value.to(device) for key, value in source.items()}
        return self._tensors[device]


def read_recorded_rows(dataset_meta: Any, *, has_strokes: bool = False) -> RecordedRows:
    """Returns states, labels, executed actions, and masks of labels and of trained rows; raises as `read_columns` does.

    With ``has_strokes``, for dense rows, also the numbers of their strokes.

    An episode's last row is its final observation, with a command to stay that was not sent. It is no label: a policy
    that learnt it would stop a little before the goal.
    """
    executed = EXECUTED if EXECUTED in dataset_meta.features else ACTION
    flags = [key for key in (DONE, OUTCOME) if key in dataset_meta.features]
    columns = read_columns(dataset_meta, dict.fromkeys((INDEX, EPISODE, STATE, ACTION, executed, *flags)))
    done, outcome = (columns.pop(key, np.zeros(len(columns[INDEX]))).reshape(-1) for key in (DONE, OUTCOME))
    done = done.astype(np.bool_)
    columns[DEPARTS] = _departures(columns[ACTION], columns[executed], done | (outcome != GOES_ON))
    masks = {IS_LABEL: ~done, IS_TRAINED: is_trained(dataset_meta, columns[EPISODE].reshape(-1))}
    columns |= {EXECUTED: columns[executed], **masks}
    return RecordedRows(columns | ({STROKE: _stroke_numbers(columns)} if has_strokes else {}))


def are_same_actions(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.bool_]:
    """Returns whether actions, each (R, A), are the same within `SAME_ACTION`, (R,)."""
    same: NDArray[np.bool_] = (np.abs(one - other) <= SAME_ACTION).all(axis=1)
    return same


def _departures(action: NDArray[Any], executed: NDArray[Any], ends: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns `DEPARTS` (R,) of labels and sent actions, each (R, A); ``ends`` (R,): last rows of key frames."""
    departed = np.append(0, np.cumsum(~are_same_actions(action, executed)))
    last = np.flatnonzero(ends)
    departs = np.zeros(len(ends), np.bool_)
    departs[last] = np.diff(departed[last + 1], prepend=0) > 0
    return departs


def _stroke_numbers(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
    """Returns the number of each row's stroke (R,)."""
    commands, poses = (torch.from_numpy(columns[key][:, :ACTION_DIM]) for key in (EXECUTED, STATE))
    _, last = episode_bounds(columns[EPISODE].reshape(-1))
    ends = np.unique(last) + 1
    parts = [
        strokes.starts_stroke(commands[None, start:end], poses[None, [*range(start, end), end - 1]])[0].numpy()
        for start, end in zip([0, *ends[:-1]], ends, strict=True)
    ]
    return np.cumsum(np.concatenate(parts), dtype=np.int64)


def check_batch(config: Any, batch: Mapping[str, Any], state: Tensor, actions: Tensor, mirrored: float) -> None:
    """Raises `ConfigurationError` if a batch does not fit the policy and its dataset; for the first batch.

    Args:
        config: configuration of the policy.
        batch: preprocessed.
        state: (B, S, D) of the batch.
        actions: (B, A) looked up for the batch's rows, normalised.
        mirrored: share of scenes that the preprocessor mirrors.
    """
    if state.shape[1] != config.n_obs_steps:
        raise ConfigurationError(
            "A batch has the wrong number of observed steps.",
            got=f"{STATE} with {state.shape[1]} steps",
            allowed=f"n_obs_steps={config.n_obs_steps}, as (B, {config.n_obs_steps}, {state.shape[-1]})",
            hint="LeRobotDataset(..., delta_timestamps=resolve_delta_timestamps(config, meta))",
        )
    if mirrored != config.augmentation_mirror and config.has_pose_layout:
        raise ConfigurationError(
            "The augmentation of a checkpoint cannot be changed: LeRobot loads its processor as it was saved.",
            got=f"a share of {mirrored} mirrored, but --policy.augmentation_mirror={config.augmentation_mirror}",
            allowed="the option that the checkpoint was trained with",
            hint="leave --policy.augmentation_mirror out, or train from new weights",
        )
    labels = batch[ACTION].reshape(len(batch[ACTION]), -1)
    if labels.shape != actions.shape or not torch.allclose(labels.to(actions), actions, atol=1e-3):
        raise ConfigurationError(
            "A batch does not belong to the dataset that the policy was created with.",
            got=f"actions {tuple(labels.shape)} that differ from the rows of its index, {tuple(actions.shape)}",
            allowed="batches of that dataset, preprocessed with its statistics",
            hint="a new training, or --resume=true with the original dataset",
        )
