"""Experts at control rate: each key frame becomes a timed path of dense actions, observed and sent step by step."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import EE_DELTA
from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrameLabels, KeyFrames, MotionLimits, Outcome
from lerobot_adamanip.contract.observation import Observation, observation_columns
from lerobot_adamanip.contract.rotations import angle_between, pose_from_vector, quintic_duration, straight_path
from lerobot_adamanip.episode.options import TIME_LIMIT
from lerobot_adamanip.episode.rollout import RolloutResult, SimulatedEnvironment, play

Array = NDArray[np.float64]

TICK = 0.02
"""Control tick, in which `MotionLimits` counts [s]."""
LEAD = 0.05
"""Time by which a target is ahead of the arm on its path [s]. With twice as much, the arm would accelerate so hard that
it lags as if it were blocked."""
MOST_STRAINED = 0.5
"""Longest time that a blocked arm takes to give up its strain [s]."""
GRIPPER_MOVES = 0.05
"""Difference of commanded gripper openings above which the fingers move."""
FINGERS_REST = 0.02
"""Change of the gripper's opening in one step below which the fingers stand still."""
CLOSE, ALIGNED = 0.004, 0.04
"""Position [m] and rotation [rad] left to a goal with which the next key frame starts before the arm is at rest.
Waiting for rest at each goal, and a fixed time for the fingers, made 88 rows of a bottle's 66."""


class DenseEnvironment(SimulatedEnvironment, Protocol):
    """Environment with a fixed time per step: `lerobot_env_adamanip.dense_env.DenseEnv`."""

    options: Any
    motion_limits: MotionLimits

    def action_toward(self, target: Array, gripper: float) -> NDArray[np.float32]:
        """Returns the action that moves the tool to a pose (4, 4), robot base frame, and the gripper."""

    @property
    def is_blocked(self) -> bool:
        """Whether the tool presses against an obstacle in front of its target."""

    @property
    def is_unreachable(self) -> bool:
        """Whether the arm cannot move any closer to its target."""

    @property
    def is_at_rest(self) -> bool:
        """Whether the arm's joints stand still."""


@dataclass(frozen=True)
class DenseStep:
    """One step of a dense rollout.

    Attributes:
        observation: before the action.
        action: action of the expert.
        goal: key frame that it is part of.
        outcome: how the key frame ended; None in a step that does not end it.
        following: observation after the action.
        success: whether the task is done by now.
        labels: labels of the try in this step.
        executed: action that was sent, if it is not ``action``: see `lerobot_adamanip.collection.corrections`.
    """

    observation: Observation
    action: NDArray[np.float32]
    goal: Goal
    outcome: Outcome | None
    following: Observation
    success: bool
    labels: KeyFrameLabels
    executed: NDArray[np.float32] | None = None


class DenseRun:
    """Implements `lerobot_adamanip.episode.rollout.Run` at control rate, in a freshly reset environment.

    Args:
        env: reset; ``observation`` is what its reset returned.
        observation: the first one.
        on_step: called with every step.
        past_success: whether the run continues after success.
    """

    def __init__(
        self,
        env: DenseEnvironment,
        observation: Observation,
        on_step: Callable[[DenseStep], None] | None = None,
        *,
        past_success: bool = False,
    ) -> None:
        self._env, self.observation, self._on_step, self._past = env, observation, on_step, past_success
        self._opening, self._outcome = 1.0, None  # type: tuple[float, Outcome | None]
        self.success, self.has_ended, self.limit, self.key_frames = False, False, "", 0

    @property
    def feedback(self) -> Feedback:
        """Feedback of the latest key frame."""
        return replace(self._env.feedback, outcome=self._outcome)

    def drive(self, goal: Goal, sent: NDArray[np.float32] | None = None) -> Feedback:
        """Drives the path of a key frame. In place of a path to ``sent``, rows still have the path to the goal."""
        if sent is None:
            self.follow(goal)
        else:
            other = self._motion(Goal(*pose_from_vector(sent), goal.phase))
            self.follow(goal, lambda _: other.action(), other)
        return self.feedback

    def follow(
        self,
        goal: Goal,
        sends: Callable[[NDArray[np.float32]], NDArray[np.float32]] | None = None,
        driven: KeyFrameMotion | None = None,
        most_steps: int | None = None,
    ) -> Outcome | None:
        """Follows the path to a goal until its key frame ends, the run ends, or for ``most_steps``.

        Args:
            goal: of the key frame, whose path labels the steps.
            sends: returns the action that is sent in place of a label (A,); None sends the labels.
            driven: path that decides the end of the key frame; None for the goal's.
            most_steps: None for no limit. The step that it ends counts as one that ran out of time.

        Returns:
            how the path ended; None if it did not.
        """
        env, labelled, steps = self._env, self._motion(goal), 0
        self._outcome, self.key_frames = None, self.key_frames + 1
        felt: Outcome | None = None
        while self._outcome is None and not self.has_ended:
            label = labelled.action()
            sent = label if sends is None else sends(label)
            following, _, terminated, truncated, info = env.step(sent)
            felt, steps = (driven or labelled).outcome(), steps + 1
            self._outcome = Outcome.TIMEOUT if felt is None and steps == most_steps else felt
            self.success = self.success or bool(info["is_success"])
            self.has_ended = truncated or (terminated and not self._past)
            self.limit = info.get("limit", TIME_LIMIT) if self.has_ended else ""
            if self._on_step is not None:
                executed = None if sends is None else sent
                now = following, self.success, env.labels
                self._on_step(DenseStep(self.observation, label, goal, self._outcome, *now, executed))
            self.observation = following
            self._opening = float(0.5 * (sent[-1] + 1.0) if env.options.action == EE_DELTA else sent[-1])
        return felt

    def _motion(self, goal: Goal) -> KeyFrameMotion:
        moves_gripper = abs(goal.gripper - self._opening) > GRIPPER_MOVES
        is_strained = self._outcome is Outcome.STALLED
        return KeyFrameMotion(self._env, goal, moves_gripper=moves_gripper, strained=is_strained)


def dense_rollout(
    env: DenseEnvironment,
    observation: Observation,
    expert: KeyFrames,
    on_step: Callable[[DenseStep], None] | None = None,
    *,
    past_success: bool = False,
) -> RolloutResult:
    """Runs an expert at control rate, as `rollout` does by key frames; ``on_step`` is called with every step."""
    return play(DenseRun(env, observation, on_step, past_success=past_success), expert)


@dataclass
class DenseRecorder:
    """Records dense steps. Row t: observation t, the action sent from it, and its labels.

    The last row is terminal: the final observation, with an action that keeps the tool pose and was not sent.

    Attributes:
        env: the environment.
        steps: recorded steps.
    """

    env: DenseEnvironment
    steps: list[DenseStep] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._joints = [self.env.joints()]

    def record(self, step: DenseStep) -> None:
        """Adds one step."""
        self.steps.append(step)
        self._joints.append(self.env.joints())

    def columns(self) -> dict[str, NDArray[Any]]:
        """Returns the episode as one (T + 1, ...) array per dataset column; the last row is terminal.

        A row's label of a try is the final one: whether the joint had moved by the end of the try.
        """
        if not self.steps:
            return {}
        last, count = self.steps[-1], len(self.steps)
        stay = self.env.action_toward(self.env.feedback.tcp_in_base, last.goal.gripper)
        observations = [*(step.observation for step in self.steps), last.following]
        goals = [*(step.goal for step in self.steps), last.goal]
        columns = {
            **_stacked([observation_columns(each) for each in observations]),
            schema.ACTION: np.stack([*(step.action for step in self.steps), stay]),
            schema.KEY_FRAME: np.stack([goal.action() for goal in goals]),
            schema.JOINTS: np.stack(self._joints),
        }
        sent = [step.action if step.executed is None else step.executed for step in self.steps]
        columns[schema.EXECUTED] = np.stack([*sent, stay])
        outcomes = [schema.GOES_ON if step.outcome is None else step.outcome for step in self.steps]
        labels = {
            schema.PHASE: [goal.phase for goal in goals],
            schema.OUTCOME: [*outcomes, schema.GOES_ON],
            **self._tries(),
            schema.SUCCESS: [*(step.success for step in self.steps), last.success],
            schema.DONE: [False] * count + [True],
        }
        dtypes = {**schema.LABEL_DTYPES, schema.DIRECTION: "int64"}
        return columns | {key: np.array(values, dtypes[key])[:, None] for key, values in labels.items()}

    def _tries(self) -> dict[str, list[Any]]:
        """Returns the columns that label tries. One that starts after the success is in no record and has no label."""
        sequence = self.env.episode_record()["try_sequence"]
        labels = [step.labels if step.labels.number < len(sequence) else KeyFrameLabels() for step in self.steps]
        labels.append(KeyFrameLabels())
        failed = [each.number >= 0 and bool(sequence[each.number][2]) for each in labels]
        ends = {each.number: row for row, each in enumerate(labels)}
        counted = sorted(row for number, row in ends.items() if number >= 0 and sequence[number][2])
        return {
            schema.TRIED: [each.tried for each in labels],
            schema.DIRECTION: [each.direction for each in labels],
            schema.FAILED: failed,
            schema.PROGRESS: [each.progress for each in labels],
            schema.TRIAL: [bisect.bisect_left(counted, row) for row in range(len(labels))],
        }


def _stacked(rows: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {key: np.stack([row[key] for row in rows]) for key in rows[0]}


class KeyFrameMotion:
    """Dense motion of one key frame: a straight line with a smooth speed profile, as the key-frame driver moves.

    Args:
        env: environment, at the start of the key frame.
        goal: the key frame.
        moves_gripper: whether its fingers move. The arm waits for them, for `MotionLimits.grip_ticks` at most.
        strained: whether the arm is still blocked by the motion before, which it may be for `MOST_STRAINED`.
    """

    def __init__(self, env: DenseEnvironment, goal: Goal, *, moves_gripper: bool, strained: bool) -> None:
        self._env, self._goal, self._limits = env, goal, env.motion_limits
        self._start, self._time, self._step_time = env.feedback.tcp_in_base, 0.0, 1.0 / env.options.fps
        self._opening, self._moves_gripper = env.feedback.gripper, moves_gripper
        self._strained_until = MOST_STRAINED if strained else 0.0
        distance = float(np.linalg.norm(goal.tcp_in_base[:3, 3] - self._start[:3, 3]))
        angle = angle_between(self._start[:3, :3], goal.tcp_in_base[:3, :3])
        limits = self._limits
        self._duration = max(
            quintic_duration(distance, limits.linear_speed, limits.linear_acceleration),
            quintic_duration(angle, limits.angular_speed, limits.angular_acceleration),
            TICK,
        )

    def action(self) -> NDArray[np.float32]:
        """Returns the next action: towards the point of the path that is `LEAD` ahead, less at its start.

        A strained arm first gives up its strain.
        """
        share = min(1.0, (self._time + self._step_time + min(LEAD, self._time)) / self._duration)
        smooth = np.array([share**3 * (10 - 15 * share + 6 * share**2)])
        (target,) = (
            straight_path(self._start, self._goal.tcp_in_base, smooth) if share < 1 else [self._goal.tcp_in_base]
        )
        self._time += self._step_time
        return self._env.action_toward(target, self._goal.gripper)

    def outcome(self) -> Outcome | None:
        """Returns how the latest step has ended the key frame; None if it has not."""
        limits, env = self._limits, self._env
        if not env.is_blocked:
            self._strained_until = 0.0
        elif self._time >= self._strained_until:
            return Outcome.STALLED
        if self._time >= limits.max_ticks * TICK:
            return Outcome.TIMEOUT
        waited = self._time - self._duration
        actual, goal = env.feedback.tcp_in_base, self._goal.tcp_in_base
        distance = np.linalg.norm(actual[:3, 3] - goal[:3, 3])
        angle = angle_between(actual[:3, :3], goal[:3, :3])
        is_far = distance > limits.reached_position or angle > limits.reached_rotation
        if env.is_unreachable and is_far:
            return Outcome.UNREACHABLE
        if self._fingers_move(waited) or waited < 0:
            return None
        if (distance < CLOSE and angle < ALIGNED) or (env.is_at_rest and not is_far):
            return Outcome.REACHED
        if waited < limits.settle_ticks * TICK:
            return None
        return Outcome.STALLED if is_far else Outcome.REACHED

    def _fingers_move(self, waited: float) -> bool:
        """Returns whether the fingers have not come to rest yet, ``waited`` seconds after the arm has arrived."""
        before, self._opening = self._opening, self._env.feedback.gripper
        rest = self._time > self._step_time and abs(self._opening - before) < FINGERS_REST
        self._moves_gripper = self._moves_gripper and not rest and waited < self._limits.grip_ticks * TICK
        return self._moves_gripper
