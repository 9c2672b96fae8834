"""Read an episode of a dataset for display."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import is_asset_id, make_object
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome, Phase
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.json_fields import parse

Array = NDArray[np.float32]


class Try(NamedTuple):
    """A try at a joint."""

    key_frame: int
    joint: str
    failed: bool
    progress: float
    """Motion of the joint in the commanded direction [rad or m]."""
    recovers: bool
    """Whether it succeeded after a failed try."""


@dataclass(frozen=True)
class ViewedEpisode:
    """An episode of T rows; each row is the observation before its key frame.

    Attributes:
        title: one line: object, hidden state, result.
        clouds: (T, N, 3) points, robot base frame [m].
        tools: (T, 10) poses of the tool, as in the contract's action.
        goals: (T - 1, 10) commanded poses.
        effort: (T, 7) external joint torques [N m]; empty if not recorded.
        phases: of each key frame; None if unlabelled.
        outcomes: of each key frame; None if not recorded.
        tries: in order.
        seconds: (T,) time of each row [s].
        images: (T, H, W, 3) RGB; None if there are none.
    """

    title: str
    clouds: Array
    tools: Array
    goals: Array
    effort: Array
    phases: tuple[Phase | None, ...]
    outcomes: tuple[Outcome | None, ...]
    tries: tuple[Try, ...]
    seconds: Array
    images: NDArray[np.uint8] | None

    @property
    def key_frames(self) -> int:
        """Number of actions that were sent."""
        return len(self.goals)


def read_episode(root: Path, number: int, *, images: bool = False) -> ViewedEpisode:
    """Reads an episode of any dataset with a cloud, a state and actions in the contract's form.

    Raises:
        DatasetError: the dataset is missing, half written or damaged.
        ConfigurationError: it has no such episode.
    """
    dataset = Dataset(root)
    episode = dataset.episode(number)
    row, columns, length = episode.row, dataset.columns(episode), episode.length
    sent = length - 1 if columns.get(schema.DONE, [False])[-1] else length
    tries = tuple(_tries(columns, sent, _joint_names(row.get("object_id"))))
    has_images = schema.FRONT_IMAGE in dataset.features
    return ViewedEpisode(
        title=_title(number, row, tries),
        clouds=as_points(columns[schema.POINT_CLOUD]).astype(np.float32),
        tools=columns[schema.STATE][:, : schema.ACTION_DIM].astype(np.float32),
        goals=columns.get(schema.EXECUTED, columns[schema.ACTION])[:sent].astype(np.float32),
        effort=columns.get(schema.EFFORT, np.zeros((length, 0))).astype(np.float32),
        phases=_labels(Phase, columns.get(schema.PHASE), sent),
        outcomes=_labels(Outcome, columns.get(schema.OUTCOME), sent),
        tries=tries,
        seconds=columns["timestamp"].astype(np.float32),
        images=_images(root, number) if images and has_images else None,
    )


def _labels[Label: enum.IntEnum](
    kind: type[Label], column: NDArray[Any] | None, count: int
) -> tuple[Label | None, ...]:
    """Returns the labels of the first rows; None if the column or the label is missing."""
    known = {int(label): label for label in kind}
    codes = [-1] * count if column is None else column[:count].astype(int).tolist()
    return tuple(known.get(code) for code in codes)


def _tries(columns: Mapping[str, NDArray[Any]], sent: int, names: tuple[str, ...]) -> Iterator[Try]:
    if schema.TRIED not in columns:
        return
    failed_before = False
    for number, joint in enumerate(columns[schema.TRIED][:sent].astype(int).tolist()):
        if joint >= 0:
            failed = bool(columns[schema.FAILED][number])
            name = names[joint] if joint < len(names) else f"joint {joint}"
            progress = float(columns[schema.PROGRESS][number])
            yield Try(number, name, failed, progress, recovers=failed_before and not failed)
            failed_before = failed


def _joint_names(identifier: object) -> tuple[str, ...]:
    """Returns joint names of a generated object, the opening joint first; empty for other objects."""
    if not isinstance(identifier, str) or is_asset_id(identifier):
        return ()
    try:
        return make_mechanism(make_object(identifier)).joints
    except AdaManipError:
        return ()


def _images(root: Path, number: int) -> NDArray[np.uint8]:
    dataset = open_dataset(root, episodes=[number], video_backend="pyav", return_uint8=True)
    frames = [dataset[place][schema.FRONT_IMAGE].numpy() for place in range(len(dataset))]
    return np.stack(frames).transpose(0, 2, 3, 1).astype(np.uint8)


def _title(number: int, row: Mapping[str, Any], tries: tuple[Try, ...]) -> str:
    failed = sum(each.failed for each in tries)
    success = row.get("success")
    ended = "" if success is None else "success" if success else "no success"
    counted = f"{failed} failed {'try' if failed == 1 else 'tries'}" if tries else ""
    told = (" after " if success else ", ").join(filter(None, (ended, counted)))
    parts = [f"episode {number}", str(row.get("object_id") or ", ".join(row["tasks"])), _hidden(row), told]
    return " · ".join(part for part in parts if part)


def _hidden(row: Mapping[str, Any]) -> str:
    try:
        hidden = sorted(parse(row["hidden_state"]).items())
    except (ValueError, KeyError, TypeError, AttributeError):
        return ""
    told = (f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}".lower() for name, value in hidden)
    return f"hidden: {', '.join(told)}" if hidden else ""
