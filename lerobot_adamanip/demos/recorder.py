"""Recording as an observer: what was seen, what was sent, how it ended, one row per key frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import schema
from lerobot_adamanip.observation import observation_columns
from lerobot_adamanip.rollout import KeyFrame


@dataclass
class EpisodeRecorder:
    """Collects key frames. Row t: observation t, the action sent from it, its labels, and how that action ended.

    Attributes:
        rows: so far, column -> array.
        trials: tries at the mechanism so far.
    """

    rows: list[dict[str, NDArray[Any]]] = field(default_factory=list)
    trials: int = 0

    def record(self, key_frame: KeyFrame) -> None:
        """Adds one key frame."""
        goal, feedback = key_frame.goal, key_frame.feedback
        if feedback.outcome is None:
            raise ValueError("Feedback of a finished key frame carries an outcome; this one is from before the first.")
        self.trials = max(self.trials, goal.trial + 1)
        labels = {schema.PHASE: goal.phase, schema.TRIAL: goal.trial, schema.OUTCOME: feedback.outcome}
        self.rows.append(
            {
                **observation_columns(key_frame.observation),
                schema.ACTION: goal.action().astype(np.float32),
                **{key: np.array([int(value)], dtype=np.int64) for key, value in labels.items()},
            }
        )

    def columns(self) -> dict[str, NDArray[Any]]:
        """Returns the episode as one (T, ...) array per dataset column."""
        return {key: np.stack([row[key] for row in self.rows]) for key in self.rows[0]} if self.rows else {}
