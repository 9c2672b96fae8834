"""Labels, records and logs of episodes; they never enter an observation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_adamanip.catalog import object_split
from lerobot_adamanip.contract.keyframes import CLOSED_HAND, KeyFrameLabels
from lerobot_adamanip.contract.seeds import split_of
from lerobot_adamanip.episode.options import BEST, TIME_LIMIT, TOO_MANY_TRIES, EnvironmentOptions
from lerobot_adamanip.episode.tries import KeyFrameLabeler
from lerobot_adamanip.evaluation.record import EpisodeRecord, Provenance, append_record
from lerobot_adamanip.mechanisms import best_tries

if TYPE_CHECKING:  # the simulator is imported at the first reset
    from lerobot_env_adamanip.sim.tasks import AdaManipTask


class EpisodeMonitor:
    """Labels and counts the key frames of one episode, right after a reset of ``task``.

    ``success`` stays True once a joint is beyond its goal at the end of a key frame. ``given_seed`` is the
    evaluation's seed, ``seed`` the scene's.
    """

    def __init__(
        self,
        task: AdaManipTask,
        *,
        seed: int,
        given_seed: int,
        provenance: Provenance,
        options: EnvironmentOptions,
    ) -> None:
        self._task, self.seed, self._given_seed, self._provenance = task, seed, given_seed, provenance
        self._hidden = task.hidden_state()
        most = options.max_failed_tries
        _, worst = best_tries(task.obj.category, options.mechanism_rules, self._hidden)
        self._max_failed_tries = None if most is None else worst if most == BEST else int(most)
        self._options = options
        self.key_frames = self.clipped_goals = 0
        self.success = False
        self._labeler = KeyFrameLabeler(task.tries)

    @property
    def labels(self) -> KeyFrameLabels:
        """Labels of the latest key frame."""
        return self._labeler.labels

    @property
    def limit(self) -> str | None:
        """The limit that has ended the episode: `TIME_LIMIT` or `TOO_MANY_TRIES`; None if there is none yet."""
        if self._max_failed_tries is not None and self.record().failed_tries > self._max_failed_tries:
            return TOO_MANY_TRIES
        return TIME_LIMIT if self.key_frames >= self._options.max_key_frames else None

    def after_key_frame(self) -> bool:
        """Counts and labels a finished key frame. Returns whether the episode has succeeded."""
        self.key_frames += 1
        self.clipped_goals += self._task.feedback.is_clipped
        _, gripper = self._task.goal
        self._labeler.after_key_frame(self._task.joint_positions(), opens=gripper > CLOSED_HAND)
        self.success |= self._task.succeeded() and self.limit != TOO_MANY_TRIES
        return self.success

    def record(self) -> EpisodeRecord:
        """Returns the record of the episode so far."""
        object_id = self._task.obj.object_id
        return EpisodeRecord(
            seed=self.seed,
            given_seed=self._given_seed,
            split=split_of(self.seed),
            object_id=object_id,
            object_split=object_split(object_id),
            hidden_state=self._hidden,
            success=self.success,
            key_frames=self.key_frames,
            clipped_goals=self.clipped_goals,
            max_key_frames=self._options.max_key_frames,
            max_failed_tries=self._max_failed_tries,
            poses=self._options.poses,
            try_sequence=tuple((each.joint, each.direction, each.failed) for each in self._task.tries.tries),
            joints=self._task.joint_positions(),
            provenance=self._provenance,
        )


class EpisodeLog:
    """Log of one environment, which numbers the evaluations of a run.

    ``lerobot-train`` evaluates the same scenes repeatedly; a repeated episode marks the next evaluation.

    Args:
        path: log file; other environments may append to it too.
        seeds: half-open range of given seeds to log; None for all. The last batch of an evaluation runs surplus
            episodes, which LeRobot does not count.
    """

    def __init__(self, path: Path, seeds: tuple[int, int] | None = None) -> None:
        self.path, self._seeds = path, None if seeds is None else range(*seeds)
        self._evaluation = 0
        self._logged: set[tuple[object, ...]] = set()

    def append(self, record: EpisodeRecord) -> None:
        """Appends an ended episode, unless its given seed is outside the range."""
        if self._seeds is not None and record.given_seed not in self._seeds:
            return
        if record.identity in self._logged:
            self._evaluation += 1
            self._logged.clear()
        self._logged.add(record.identity)
        made = replace(record.provenance, evaluation=self._evaluation)
        append_record(self.path, replace(record, provenance=made))
