"""Recorder: one dataset row per key frame, with observation, action, labels and outcome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Goal, KeyFrameLabels, Outcome
from lerobot_adamanip.contract.observation import observation_columns
from lerobot_adamanip.episode.rollout import KeyFrame

Row = dict[str, NDArray[Any]]


@dataclass
class EpisodeRecorder:
    """Records key frames. Row t: observation t, the action sent from it, its labels, and its outcome.

    The last row is terminal: the final observation, with an action that keeps the tool pose and was not sent.

    Attributes:
        joints: returns the present joint positions (13,), see `schema.JOINT_NAMES`.
        rows: recorded rows, column -> array, without the terminal one.
    """

    joints: Callable[[], NDArray[np.float32]]
    rows: list[Row] = field(default_factory=list)
    _last: KeyFrame | None = None
    _before: NDArray[np.float32] = field(init=False)

    def __post_init__(self) -> None:
        self._before = self.joints()

    def record(self, key_frame: KeyFrame) -> None:
        """Adds one key frame."""
        outcome = key_frame.feedback.outcome
        if outcome is None:
            raise ValueError("Feedback of a finished key frame carries an outcome; this one is from before the first.")
        labels = key_frame.labels
        self._last = key_frame
        row = self._row(key_frame.observation, key_frame.goal, outcome, labels, success=key_frame.success, done=False)
        executed = row[schema.ACTION] if key_frame.executed is None else key_frame.executed
        self.rows.append({**row, schema.EXECUTED: executed, schema.JOINTS: self._before})
        self._before = self.joints()

    def columns(self) -> Row:
        """Returns the episode as one (T + 1, ...) array per dataset column; the last row is terminal."""
        if self._last is None:
            return {}
        last = self._last
        stay = Goal(last.feedback.tcp_in_base, last.goal.gripper, last.goal.phase)
        labels = KeyFrameLabels(trial=last.labels.trial + last.labels.failed)
        end = self._row(last.following, stay, Outcome.REACHED, labels, success=last.success, done=True)
        end |= {schema.EXECUTED: end[schema.ACTION], schema.JOINTS: self._before}
        return {key: np.stack([row[key] for row in (*self.rows, end)]) for key in end}

    def _row(
        self, observation: Any, goal: Goal, outcome: Outcome, labels: KeyFrameLabels, *, success: bool, done: bool
    ) -> Row:
        values = {
            schema.PHASE: goal.phase,
            schema.TRIAL: labels.trial,
            schema.OUTCOME: outcome,
            schema.TRIED: labels.tried,
            schema.FAILED: labels.failed,
            schema.PROGRESS: labels.progress,
            schema.SUCCESS: success,
            schema.DONE: done,
        }
        return {
            **observation_columns(observation),
            schema.ACTION: goal.action().astype(np.float32),
            **{key: np.array([value], dtype=schema.LABEL_DTYPES[key]) for key, value in values.items()},
        }
