"""Recording as an observer: what was seen, what was sent, how it ended, one row per key frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import schema
from lerobot_adamanip.experts.base import Feedback, Goal, KeyFrames

Observation = Mapping[str, Any]


class KeyframeEnv(Protocol):
    """What collection and replay need of an environment: `lerobot_env_adamanip.keyframe_env.KeyframeEnv`, or a fake."""

    _max_episode_steps: int

    @property
    def task_description(self) -> str:
        """Returns the instruction in words."""

    @property
    def feedback(self) -> Feedback:
        """Returns what was felt after the latest key frame."""

    @property
    def annotations(self) -> Any:
        """Returns the annotated part poses an expert may know."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts the episode of ``seed`` on ``options["object_id"]``."""

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drives the arm to one key frame, a (10,) action of the contract."""

    def hidden_state(self) -> dict[str, Any]:
        """Returns this episode's draw of the mechanism, JSON-able. Privileged."""

    def episode_record(self) -> dict[str, Any]:
        """Returns what describes the episode, JSON-able."""

    def camera_parameters(self) -> dict[str, Any]:
        """Returns intrinsics and extrinsics of the front camera in this episode, JSON-able."""

    def close(self) -> None:
        """Releases the simulator."""


def observation_columns(observation: Observation) -> dict[str, NDArray[Any]]:
    """Returns the dataset columns of one Gym observation: copies, so that the environment may reuse its buffers."""
    return {
        schema.POINT_CLOUD: np.array(observation["point_cloud"], dtype=np.float32),
        schema.STATE: np.array(observation["agent_pos"], dtype=np.float32),
        schema.EFFORT: np.array(observation["effort"], dtype=np.float32),
        schema.FRONT_IMAGE: np.array(observation["pixels"]["front"], dtype=np.uint8),
    }


@dataclass
class EpisodeRecorder:
    """Collects key frames. Row t: observation t, the action sent from it, its labels, and how that action ended."""

    rows: list[dict[str, NDArray[Any]]] = field(default_factory=list)

    def record(self, observation: Observation, goal: Goal, feedback: Feedback) -> None:
        """Adds one key frame.

        Args:
            observation: what was seen before the action.
            goal: what the expert sent.
            feedback: what was felt once the action had ended.
        """
        if feedback.outcome is None:
            raise ValueError("Feedback of a finished key frame carries an outcome; this one is from before the first.")
        labels = {schema.PHASE: goal.phase, schema.TRIAL: goal.trial, schema.OUTCOME: feedback.outcome}
        self.rows.append(
            {
                **observation_columns(observation),
                schema.ACTION: goal.action().astype(np.float32),
                **{key: np.array([int(value)], dtype=np.int64) for key, value in labels.items()},
            }
        )

    def columns(self) -> dict[str, NDArray[Any]]:
        """Returns the episode as one (T, ...) array per dataset column."""
        return {key: np.stack([row[key] for row in self.rows]) for key in self.rows[0]} if self.rows else {}


@dataclass(frozen=True)
class EpisodeResult:
    """How an episode went: whether the task was done, key frames used, tries at the mechanism, and why it ended."""

    success: bool
    key_frames: int
    trials: int
    reason: str


def run_episode(
    env: KeyframeEnv, observation: Observation, expert: KeyFrames, recorder: EpisodeRecorder | None = None
) -> EpisodeResult:
    """Lets an expert work on a freshly reset environment until the task is done, time is up, or it has no more ideas.

    Args:
        env: reset; ``observation`` is what its reset returned.
        observation: the first one.
        expert: not yet primed; closed at the end.
        recorder: observer, told of every key frame.
    """
    success, trials, reason = False, 0, "the expert ended without success"
    key_frames = 0
    try:
        goal = next(expert, None)
        while goal is not None and key_frames < env._max_episode_steps:
            following, _, terminated, truncated, info = env.step(goal.action())
            key_frames += 1
            trials = max(trials, goal.trial + 1)
            if recorder is not None:
                recorder.record(observation, goal, env.feedback)
            success = success or bool(info["is_success"])
            if terminated or truncated:
                break
            observation = following
            try:
                goal = expert.send(env.feedback)
            except StopIteration:
                goal = None
        if goal is not None:
            reason = "time limit"
    finally:
        expert.close()
    return EpisodeResult(success, key_frames, trials, "success" if success else reason)
