"""The loop that runs an expert in an environment, the recorder of its rows, and the interfaces of environments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrameLabels, KeyFrames, Outcome
from lerobot_adamanip.contract.observation import Observation, observation_columns
from lerobot_adamanip.episode.options import TIME_LIMIT
from lerobot_adamanip.objects import PartAnnotation


class KeyframeEnvironment(Protocol):
    """Environment with one key frame per step: `lerobot_env_adamanip.keyframe_env.KeyframeEnv`, a robot, or a fake."""

    @property
    def max_key_frames(self) -> int:
        """Largest number of key frames per episode."""

    @property
    def task_description(self) -> str:
        """The instruction in words."""

    @property
    def feedback(self) -> Feedback:
        """Feedback of the latest key frame."""

    @property
    def labels(self) -> KeyFrameLabels:
        """Labels of the latest key frame: not for policies or experts."""

    @property
    def annotations(self) -> Mapping[str, PartAnnotation]:
        """Annotated part poses, robot base frame; experts may know them."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts the episode of ``seed`` on ``options["object_id"]``."""

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drives the arm to one key frame, a (10,) action of the contract."""

    def part_positions(self) -> dict[str, float]:
        """Returns the object's current joint positions [rad or m]; a camera could see them too."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the object's joints, in the order of `labels`; the joint that opens comes first."""

    def software_versions(self) -> dict[str, str]:
        """Returns name -> version of the software that decides episodes; see `lerobot_adamanip.contract.versions`."""

    def hidden_state(self) -> dict[str, Any]:
        """Returns the hidden draw of this episode, JSON-able. Privileged."""

    def episode_record(self) -> dict[str, Any]:
        """Returns the record of the episode, JSON-able, with its ``try_sequence``; see `EpisodeRecord`."""

    def camera_parameters(self) -> dict[str, Any]:
        """Returns intrinsics and extrinsics of the front camera in this episode, JSON-able."""

    def close(self) -> None:
        """Releases the simulator."""


class SimulatedEnvironment(KeyframeEnvironment, Protocol):
    """Environment with full state and rendering, for recording demonstrations."""

    def drive(self, action: NDArray[np.float32]) -> tuple[bool, bool]:
        """Runs a key frame without an observation. Returns whether the task is done, and whether a limit is reached."""

    def restart_episode(self) -> None:
        """Starts counting key frames and tries in the present state, as at a reset."""

    def observe(self) -> Observation:
        """Returns the current observation."""

    def joints(self) -> NDArray[np.float32]:
        """Returns the positions of all joints (13,), see `schema.JOINT_NAMES`: for records, never for policies."""

    def render(self) -> NDArray[np.uint8]:
        """Returns a picture (H, W, 3) of the current state."""

    def pictures_at(self, joints: NDArray[np.float32]) -> dict[str, NDArray[np.uint8]]:
        """Returns camera -> picture (H, W, 3) of this episode's scene at rest, with these ``joints`` (13,)."""


@dataclass(frozen=True)
class KeyFrame:
    """One key frame of a rollout.

    Attributes:
        observation: before the action.
        goal: goal of the expert.
        feedback: after the action.
        following: observation after the action.
        success: whether the task is done by now.
        labels: its try and the result.
        executed: (10,) action that was sent, if it is not the goal's; see `lerobot_adamanip.collection.corrections`.
    """

    observation: Observation
    goal: Goal
    feedback: Feedback
    following: Observation
    success: bool
    labels: KeyFrameLabels
    executed: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class RolloutResult:
    """Result of a rollout: success, number of key frames, and why it ended."""

    success: bool
    key_frames: int
    reason: str


class Run(Protocol):
    """An episode that goals drive: `KeyFrameRun`, or `lerobot_adamanip.episode.dense.DenseRun` at control rate.

    Attributes:
        success: whether the task is done by now.
        has_ended: whether a limit, or a success that ends the run, has been reached.
        limit: the limit that has ended it; empty before.
        key_frames: number of key frames so far.
    """

    success: bool
    has_ended: bool
    limit: str
    key_frames: int

    @property
    def feedback(self) -> Feedback:
        """Feedback of the latest key frame."""

    def drive(self, goal: Goal, sent: NDArray[np.float32] | None = None) -> Feedback:
        """Drives the arm to a goal, or to another pose ``sent`` (10,) in its place, and returns the feedback."""


class KeyFrameRun:
    """Implements `Run` by key frames, in a freshly reset environment.

    Args:
        env: reset; ``observation`` is what its reset returned.
        observation: the first one.
        on_key_frame: called with every key frame.
        past_success: whether the run continues after success.
    """

    def __init__(
        self,
        env: KeyframeEnvironment,
        observation: Observation,
        on_key_frame: Callable[[KeyFrame], None] | None = None,
        *,
        past_success: bool = False,
    ) -> None:
        self._env, self.observation, self._on_key_frame, self._past = env, observation, on_key_frame, past_success
        self.success, self.has_ended, self.limit, self.key_frames = False, False, "", 0

    @property
    def feedback(self) -> Feedback:
        """Feedback of the latest key frame."""
        return self._env.feedback

    def drive(self, goal: Goal, sent: NDArray[np.float32] | None = None) -> Feedback:
        """Drives a key frame; see `Run`."""
        env = self._env
        following, _, terminated, truncated, info = env.step(goal.action() if sent is None else sent)
        self.key_frames += 1
        self.success = self.success or bool(info["is_success"])
        if self._on_key_frame is not None:
            frame = KeyFrame(self.observation, goal, env.feedback, following, self.success, env.labels, sent)
            self._on_key_frame(frame)
        self.observation = following
        is_full = self.key_frames >= env.max_key_frames
        self.has_ended = truncated or is_full or (terminated and not self._past)
        self.limit = info.get("limit", TIME_LIMIT) if self.has_ended else ""
        return env.feedback


def play(run: Run, expert: KeyFrames) -> RolloutResult:
    """Runs an expert until its end or the run's, and closes it."""
    try:
        goal = next(expert, None)
        while goal is not None and not run.has_ended:
            feedback = run.drive(goal)
            goal = None if run.has_ended else next_goal(expert, feedback)
    finally:
        expert.close()
    return result_of(run, "the expert ended without success")


def result_of(run: Run, reason: str) -> RolloutResult:
    """Returns the result of a run; ``reason`` is why it ended without success and without a limit."""
    return RolloutResult(run.success, run.key_frames, "success" if run.success else run.limit or reason)


def rollout(
    env: KeyframeEnvironment,
    observation: Observation,
    expert: KeyFrames,
    on_key_frame: Callable[[KeyFrame], None] | None = None,
    *,
    past_success: bool = False,
) -> RolloutResult:
    """Runs an expert in a freshly reset environment until the task is done, a limit is reached, or the expert ends.

    Args:
        env: reset; ``observation`` is what its reset returned.
        observation: the first one.
        expert: not yet primed; closed at the end.
        on_key_frame: called with every key frame.
        past_success: continue after success until the expert ends, as demonstrations do: it pulls a door wide open.
    """
    return play(KeyFrameRun(env, observation, on_key_frame, past_success=past_success), expert)


def next_goal(expert: KeyFrames, feedback: Feedback) -> Goal | None:
    """Sends feedback to an expert; returns its next goal, None if it has ended."""
    try:
        return expert.send(feedback)
    except StopIteration:
        return None


@dataclass
class EpisodeRecorder:
    """Records key frames. Row t: observation t, the action sent from it, its labels, and its outcome.

    The last row is terminal: the final observation, with an action that keeps the tool pose and was not sent.

    Attributes:
        joints: returns the present joint positions (13,), see `schema.JOINT_NAMES`.
        rows: recorded rows, column -> array, without the terminal one.
    """

    joints: Callable[[], NDArray[np.float32]]
    rows: list[dict[str, NDArray[Any]]] = field(default_factory=list)
    _labels: list[KeyFrameLabels] = field(default_factory=list)
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
        self._labels.append(labels)
        row = self._row(key_frame.observation, key_frame.goal, outcome, labels, success=key_frame.success, done=False)
        executed = row[schema.ACTION] if key_frame.executed is None else key_frame.executed
        self.rows.append({**row, schema.EXECUTED: executed, schema.JOINTS: self._before})
        self._before = self.joints()

    def columns(self) -> dict[str, NDArray[Any]]:
        """Returns the episode as one (T + 1, ...) array per dataset column; the last row is terminal.

        A try whose joint moves in a later key frame did not fail in an earlier one.
        """
        if self._last is None:
            return {}
        last = self._last
        stay = Goal(last.feedback.tcp_in_base, last.goal.gripper, last.goal.phase)
        is_new = last.labels.number > max((each.number for each in self._labels[:-1]), default=-1)
        labels = KeyFrameLabels(trial=last.labels.trial + (last.labels.failed and is_new))
        end = self._row(last.following, stay, Outcome.REACHED, labels, success=last.success, done=True)
        end |= {schema.EXECUTED: end[schema.ACTION], schema.JOINTS: self._before}
        columns = {key: np.stack([row[key] for row in (*self.rows, end)]) for key in end}
        moved = {each.number for each in self._labels if each.number >= 0 and not each.failed}
        columns[schema.FAILED][:-1, 0] &= [each.number not in moved for each in self._labels]
        columns[schema.TRIAL] = np.minimum.accumulate(columns[schema.TRIAL][::-1])[::-1]
        return columns

    def _row(
        self, observation: Any, goal: Goal, outcome: Outcome, labels: KeyFrameLabels, *, success: bool, done: bool
    ) -> dict[str, NDArray[Any]]:
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
