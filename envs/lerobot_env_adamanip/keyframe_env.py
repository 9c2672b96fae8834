"""Environment for LeRobot: one step is one key frame."""

from __future__ import annotations

import logging
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import __version__
from lerobot_adamanip.catalog import object_split
from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.control import KEYFRAME
from lerobot_adamanip.contract.dense_codec import pose_state
from lerobot_adamanip.contract.keyframes import CLOSED_HAND, Feedback, KeyFrameLabels, Outcome
from lerobot_adamanip.contract.memory import EVENTS, TEXT
from lerobot_adamanip.contract.observation import state_vector, workspace_cloud
from lerobot_adamanip.contract.schema import FPS, STATE_DIM
from lerobot_adamanip.contract.seeds import MAX_SEED, retried_seed, scene_seed, split_of
from lerobot_adamanip.contract.versions import SIMULATION_VERSION, installed_versions, software_versions
from lerobot_adamanip.episode.hints import instruction
from lerobot_adamanip.episode.memory import Memory
from lerobot_adamanip.episode.options import BEST, TIME_LIMIT, TOO_MANY_TRIES, EnvironmentOptions, require_known
from lerobot_adamanip.episode.tries import KeyFrameLabeler
from lerobot_adamanip.evaluation.record import (
    EpisodeRecord,
    Provenance,
    append_record,
    latest_evaluation,
    new_run_id,
)
from lerobot_adamanip.mechanisms import best_tries
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.util.errors import ConfigurationError, UnreachableError, require_choice
from lerobot_env_adamanip.gym_interface import (
    RENDER_MODE,
    action_space,
    environment_spec,
    observation_space,
    reset_options,
)
from lerobot_env_adamanip.sim.render_device import observes_images
from lerobot_env_adamanip.simulator import make_task, sensors_name

if TYPE_CHECKING:  # the simulator is imported at the first reset
    from lerobot_env_adamanip.sim.tasks import AdaManipTask

Observation = dict[str, Any]
SCENE_TRIES, OBJECT_TRIES = 4, 100
"""Maximum number of scenes that a reset tries: the seed's own, then others derived from the seed. Those of objects that
no pose can place, as of half of the windows with fixed poses, count as the second only."""
_logger = logging.getLogger(__name__)


class EpisodeLog:
    """Log of one environment, which numbers the evaluations of a run.

    A repeated episode marks the next evaluation, also if another process has logged it before.

    Args:
        path: log file; other environments may append to it too.
        seeds: half-open range of given seeds to log; None for all. The last batch of an evaluation runs surplus
            episodes, which LeRobot does not count.
        run_id: id of the run; None if no other environment belongs to it.
    """

    def __init__(self, path: Path, seeds: tuple[int, int] | None = None, run_id: str | None = None) -> None:
        self.path, self._seeds = path, None if seeds is None else range(*seeds)
        self._evaluation, self._logged = (0, set()) if run_id is None else latest_evaluation(path, run_id)

    def append(self, record: EpisodeRecord) -> None:
        """Appends an ended episode, unless its given seed is outside the range."""
        if self._seeds is not None and record.given_seed not in self._seeds:
            return
        if record.identity in self._logged:
            self._evaluation += 1
            self._logged.clear()
        self._logged.add(record.identity)
        provenance = replace(record.provenance, evaluation=self._evaluation)
        append_record(self.path, replace(record, provenance=provenance))


class RunningEpisode:
    """Labels, limits and record of one episode, right after a reset of its task; they never enter an observation.

    Args:
        task: the ManiSkill task of the episode, with its simulation.
        options: options of the environment.
        provenance: run and versions of the record.
        log: log of the environment, if it has one.
        seed, given_seed: seed of the scene, and of the evaluation.
        repeat: see `EpisodeRecord`.

    Attributes:
        steps: number of key frames, or of dense steps.
        success: whether a joint was beyond its goal at the end of any step.
        end: the record, set at the end of the episode; later steps do not change it.
        limit: the limit that has ended the episode, `TIME_LIMIT` or `TOO_MANY_TRIES`; otherwise empty.
    """

    def __init__(
        self,
        task: AdaManipTask,
        options: EnvironmentOptions,
        provenance: Provenance,
        log: EpisodeLog | None,
        *,
        seed: int,
        given_seed: int,
        repeat: int = 0,
    ) -> None:
        self.task, self._options, self._provenance, self._log = task, options, provenance, log
        self._seed, self._given_seed, self._repeat = seed, given_seed, repeat
        self._hidden = task.simulation.hidden_state()
        self._step_limit, self._is_dense = options.step_limit, options.is_dense
        limit = options.max_failed_tries
        _, worst = best_tries(task.category, options.mechanism_rules, self._hidden)
        self._max_failed_tries = None if limit is None else worst if limit == BEST else int(limit)
        self._labeler = KeyFrameLabeler(task.simulation.tries, is_dense=options.is_dense)
        self.steps = self.clipped_goals = 0
        self.success, self.limit = False, ""
        self.end: EpisodeRecord | None = None

    @property
    def labels(self) -> KeyFrameLabels:
        """Labels of the latest step."""
        return self._labeler.labels

    def after_step(self) -> None:
        """Counts and labels a finished step; ends the episode at success or at a limit."""
        simulation, driver = self.task.simulation, self.task.driver
        self.steps += 1
        self.clipped_goals += driver.feedback.is_clipped
        self._labeler.after_key_frame(simulation.joint_positions(), opens=driver.goal[1] > CLOSED_HAND)
        limit = TIME_LIMIT if self.steps >= self._step_limit else ""
        # A try in a key frame that was not blocked may still move its joint in the next one.
        may_go_on = self._is_dense or driver.feedback.outcome is Outcome.REACHED
        if (allowed := self._max_failed_tries) is not None and self.record(ended=may_go_on).failed_tries > allowed:
            limit = TOO_MANY_TRIES
        self.success |= simulation.succeeded() and limit != TOO_MANY_TRIES
        if self.end is None and (self.success or limit):
            self.end_by("" if self.success else limit)

    def end_by(self, limit: str) -> None:
        """Ends the episode by a limit, or by success if the limit is empty, and logs it."""
        self.limit, self.end = limit, self.record()
        if self._log is not None:
            self._log.append(self.end)

    def result(self) -> tuple[bool, bool]:
        """Returns whether the episode has ended with success, and whether it was truncated."""
        success = self.end is not None and self.end.success
        return success, self.end is not None and not success

    def record(self, *, ended: bool = False) -> EpisodeRecord:
        """Returns the record of the episode so far. ``ended`` leaves out a failed try that has not ended yet."""
        simulation = self.task.simulation
        object_id = simulation.obj.object_id
        return EpisodeRecord(
            seed=self._seed,
            given_seed=self._given_seed,
            split=split_of(self._seed),
            object_id=object_id,
            object_split=object_split(object_id),
            hidden_state=self._hidden,
            success=self.success,
            key_frames=self.steps,
            clipped_goals=self.clipped_goals,
            max_key_frames=self._step_limit,
            max_failed_tries=self._max_failed_tries,
            poses=self._options.poses,
            try_sequence=simulation.tries.sequence(ended=ended),
            joints=simulation.joint_positions(),
            repeat=self._repeat,
            sensing=self._options.sensing,
            hints=self._options.hints,
            self_calibration=self._options.self_calibration,
            control=self._options.control,
            fps=self._options.fps if self._is_dense else None,
            provenance=self._provenance,
        )


class KeyframeEnv(gym.Env[Observation, NDArray[np.float32]]):
    """AdaManip environment with key frames as steps. The simulator starts with the first reset.

    Action: (10,) next tool pose, robot base frame: position [m], rotation 6D, gripper [0 closed, 1 open].
    Observation: ``point_cloud`` (N, 3) [m], ``agent_pos`` (24,), ``effort`` (7,) [N m], and ``pixels``, camera
        -> (H, W, 3), if images are observed, see ``observe_images``. All bounds are finite. With the memory ``events``
        also ``environment_state`` (96,), see `contract.memory`; with ``text``, ``task_description`` ends with it.
    Info, of reset and of each step: ``is_success`` (bool), ``limit`` (str), the reason of a truncation or an empty
        text, and ``goal_clipped`` (bool), whether the arm was sent nearer than commanded. It holds no hidden state.
    Reward: 1 at the key frame that succeeds. The episode ends there, after ``max_key_frames``, or with one failed try
        more than ``max_failed_tries``. Later steps return observations without reward and do not change its record.

    Implements `lerobot_adamanip.episode.rollout.SimulatedEnvironment`.

    Args:
        category: ``bottle`` ... ``lamp``, see `lerobot_adamanip.contract.categories`; ``safe`` by default.
        options: all options at once ...
        render_mode: ``rgb_array`` or None, for Gymnasium; `render` works with both.
        values: ... or some options by name, see `EnvironmentOptions`.

    Raises:
        ConfigurationError: an option does not exist, or a value is invalid.
    """

    metadata = {"render_modes": [RENDER_MODE], "render_fps": FPS}  # noqa: RUF012  (Gymnasium requires it)
    CONTROL: ClassVar[str] = KEYFRAME

    def __init__(
        self,
        category: str | None = None,
        *,
        options: EnvironmentOptions | None = None,
        render_mode: str | None = RENDER_MODE,
        **values: Any,
    ) -> None:
        require_known(values)
        if render_mode is not None:
            require_choice("render mode", render_mode, (RENDER_MODE,))
        named = {} if category is None else {"category": category}
        asked = (options or EnvironmentOptions()).changed(**named, **values)
        if asked.control != self.CONTROL:
            raise ConfigurationError(
                "This environment acts with another control.",
                got=f"{type(self).__name__} with control={asked.control!r}",
                allowed=f"control={self.CONTROL!r}",
                hint="DenseEnv for dense control, KeyframeEnv for key frames; make_environment(options) chooses",
            )
        self.spec = environment_spec(asked)
        self.options = asked
        if asked.observe_images is None:
            self.options = asked.changed(observe_images=observes_images(None, asked.images_from))
        self.category, self.num_points = self.options.category, self.options.num_points
        self.workspace = self.options.workspace
        self.task = self.task_description = CATEGORIES[self.category].instruction
        self.render_mode = render_mode
        self._max_episode_steps = self.options.step_limit  # name required by LeRobot
        self.metadata = {**self.metadata, "render_fps": self.options.fps} if self.options.is_dense else self.metadata
        self._task: AdaManipTask | None = None
        self._episode: RunningEpisode | None = None
        log = None if self.options.episode_log is None else Path(self.options.episode_log)
        self._log = None if log is None else EpisodeLog(log, self.options.logged_seeds, self.options.run_id)
        run_id = None if log is None else self.options.run_id or new_run_id()  # without a log, of no evaluation
        rules, label = self.options.mechanism_rules, self.options.run_label
        self._provenance = Provenance(
            SIMULATION_VERSION, __version__, rules, run_id, label, versions=installed_versions()
        )
        self._image: NDArray[np.uint8] | None = None
        self._seeds: dict[str, int] = {}
        self._memory, self._state = Memory.of(self.options), np.zeros(0, np.float32)
        self.action_space = action_space(self.options)
        self.observation_space = observation_space(self.options)
        self._spaces: dict[str, Any] = dict(self.observation_space.spaces)

    # Gymnasium --------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode. ``seed`` determines object, poses and hidden state; equal seeds give equal episodes.

        With ``repeats`` of K, episodes whose seeds follow each other, or that are reset without a seed, play the scene
        of the first, K at a time. The seed is mapped into the environment's split. If the arm cannot reach its scene,
        other scenes derived from the seed are tried; the log records this.

        Options: ``object_id`` selects an object of the category; ``hidden_overrides`` fixes hidden values. LeRobot's
        option of a new rollout has no effect.

        Raises:
            ConfigurationError: the option, object or hidden value does not exist.
            UnreachableError: the arm cannot reach the part in any of the scenes.
        """
        self._episode = self._image = None  # after a failed reset there is no episode
        chosen = reset_options(self.options, seed, options or {})
        super().reset(seed=seed)
        if self._task is None:
            # Three quarters of the time of ManiSkill's default shader, without a GPU.
            self._task = make_task(self.category, options=self.options, shader="minimal")
        repeat = self._repeat_of(seed)
        if seed is None:
            seed = self._seeds["given_seed"] + 1 if repeat else int(self.np_random.integers(2**31))
        given_seed = int(seed)
        scene = scene_seed(given_seed - repeat + self.options.seed_offset, self.options.split)
        self._seeds = {"seed": self._load_scene(self._task, scene, chosen), "given_seed": given_seed, "repeat": repeat}
        self._start_episode(self._task)
        if self.options.hints:
            hidden, scene = self.hidden_state(), self._seeds["seed"]
            self.task = self.task_description = instruction(self.category, hidden, scene, self.options.hints)
        return self.observe(), self._info()

    def _repeat_of(self, seed: int | None) -> int:
        """Returns how many episodes with the seeds before this one have played its scene, see ``repeats``."""
        follows = self._seeds.get("given_seed", MAX_SEED) + 1
        is_next = follows == (min(follows, MAX_SEED) if seed is None else seed)
        repeat = self._seeds.get("repeat", 0) + 1
        return repeat if is_next and repeat < self.options.repeats else 0

    def _load_scene(self, task: AdaManipTask, seed: int, chosen: dict[str, Any]) -> int:
        """Resets the simulator to a reachable scene; returns its seed."""
        first, attempt, unlucky = seed, 0, 0
        is_one_object = "object_id" in chosen or len(task.object_ids) == 1
        while True:
            try:
                task.reset(seed=seed, options={"reconfigure": True, **chosen})
                return seed
            except UnreachableError as error:
                attempt, unlucky = attempt + 1, unlucky + (not error.is_certain)
                if unlucky == SCENE_TRIES or attempt == OBJECT_TRIES or (error.is_certain and is_one_object):
                    raise
                seed = retried_seed(first, self.options.split, attempt)
                _logger.warning("Seed %d: %s Another scene is drawn: seed %d.", first, str(error).split("\n")[0], seed)

    def _start_episode(self, task: AdaManipTask) -> None:
        self._episode = RunningEpisode(task, self.options, self._provenance, self._log, **self._seeds)
        if self._memory is not None:
            self._memory.reset()

    def restart_episode(self) -> None:
        """Starts counting key frames and tries in the present state, as at a reset: for late starts."""
        task = self.episode.task
        task.simulation.restart_tries()
        if task.errors is not None:
            task.errors.restart()
        self._start_episode(task)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Moves the arm to the commanded pose and observes. Raises `ConfigurationError` for a malformed action."""
        had_succeeded, before = self.episode.success, self._state
        for _ in self.motion(action):
            pass
        success, truncated = self.episode.result()
        observation = self.observe()
        if self._memory is not None:
            self._memory.after(before, action, self._state)
            observation |= self._remembered(self._memory)
        return observation, float(success and not had_succeeded), success, truncated, self._info()

    def _remembered(self, memory: Memory) -> Observation:
        """Returns the part of an observation that is the memory; updates the instruction if it holds the memory."""
        if self.options.memory == TEXT:
            self.task_description = self.task + memory.sentence()
        return {"environment_state": memory.numbers()} if self.options.memory == EVENTS else {}

    def drive(self, action: NDArray[np.float32]) -> tuple[bool, bool]:
        """Runs one key frame, in dense control too, without an observation.

        Returns:
            Whether the task is done, and whether a limit is reached.
        """
        for _ in KeyframeEnv.motion(self, action):
            pass
        return self.episode.result()

    def motion(self, action: NDArray[np.float32]) -> Generator[None]:
        """Runs one step; yields after each control tick. Closing it aborts the step, which then does not count."""
        episode = self.episode
        yield from episode.task.driver.motion(np.asarray(action))
        self._image = None
        episode.after_step()

    def end_episode(self, limit: str) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Ends the episode without success. Returns the same values as `step` at a limit; ``limit`` is the reason.

        An episode that has ended keeps its result.
        """
        if self.episode.end is None:
            self.episode.end_by(limit)
        success, truncated = self.episode.result()
        return self.observe(), 0.0, success, truncated, self._info()

    def _info(self) -> dict[str, Any]:
        """Returns the info of a reset or step: always the same keys."""
        episode = self.episode
        is_clipped = episode.task.driver.feedback.is_clipped
        return {"is_success": episode.result()[0], "limit": episode.limit, "goal_clipped": is_clipped}

    def observe(self) -> Observation:
        """Returns the present observation."""
        task, spaces = self.episode.task, self._spaces
        errors, images = task.errors, {name: task.cameras.image(name) for name in spaces.get("pixels", {})}
        if errors is not None:
            images = errors.delayed("pixels", images)
        self._image = images[FRONT].copy() if FRONT in images else None
        arm, feedback = task.simulation.arm_state(), task.driver.feedback
        observation: Observation = {}
        if len(spaces["agent_pos"].low) == STATE_DIM:
            observation["agent_pos"] = state_vector(feedback, arm.qpos, arm.qvel)
        else:
            observation["agent_pos"] = pose_state(feedback.tcp_in_base, feedback.gripper)
        if "effort" in spaces:
            effort = task.driver.effort if errors is None else errors.effort(task.driver.effort)
            observation["effort"] = effort.astype(np.float32)
        for key, values in observation.items():  # a simulated collision may give any effort
            observation[key] = np.clip(values, spaces[key].low, spaces[key].high)
        self._state = observation["agent_pos"]
        if self._memory is not None:
            observation |= self._remembered(self._memory)
        if "point_cloud" in spaces:
            cloud = workspace_cloud(task.cameras.points(), self.workspace, self.num_points)
            observation["point_cloud"] = cloud if errors is None else errors.delayed("point_cloud", cloud)
        return {**observation, "pixels": images} if images else observation

    def render(self) -> NDArray[np.uint8]:
        """Returns the latest image of the front camera (H, W, 3); black before an episode.

        Where the camera is observed, it is late with a sensor's delay.
        It is drawn by ray casting if that is the source of images, or, with a warning, without a Vulkan device.
        """
        size = self.options.image_size
        if self._image is None:
            black, episode = np.zeros((size, size, 3), np.uint8), self._episode
            self._image = black if episode is None else episode.task.cameras.picture()
        return self._image.copy()

    def close(self) -> None:
        """Ends the simulator."""
        if self._task is not None:
            self._task.close()
            self._task = self._episode = None

    # For experts, recorders and reports: `lerobot_adamanip.episode.rollout` -----------------------------------------

    @property
    def episode(self) -> RunningEpisode:
        """Running episode, with its ManiSkill task. Privileged."""
        if self._episode is None:
            raise gym.error.ResetNeeded("No episode is running: call reset() first.")
        return self._episode

    @property
    def max_key_frames(self) -> int:
        """Maximum key frames per episode."""
        return self._max_episode_steps

    @property
    def feedback(self) -> Feedback:
        """Feedback of the latest key frame."""
        return self.episode.task.driver.feedback

    @property
    def labels(self) -> KeyFrameLabels:
        """Labels of the latest key frame; not for policies or experts."""
        return self.episode.labels

    @property
    def annotations(self) -> dict[str, PartAnnotation]:
        """Annotated part poses at the episode's start, robot base frame."""
        return self.episode.task.placement.annotations

    def part_positions(self) -> dict[str, float]:
        """Returns the object's present joint positions [rad or m]."""
        return self.episode.task.simulation.joint_positions()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the object's joints in the order of `labels`: the opening joint first."""
        return self.episode.task.simulation.mechanism.joints

    def joints(self) -> NDArray[np.float32]:
        """Returns the positions of all joints, (13,), see `schema.JOINT_NAMES`; for records."""
        return self.episode.task.simulation.joints()

    def pictures_at(self, joints: NDArray[np.float32]) -> dict[str, NDArray[np.uint8]]:
        """Returns each camera's image (H, W, 3) with all joints at ``joints`` (13,), at rest; raises `SimulatorError`.

        The episode cannot continue afterwards.
        """
        task = self.episode.task
        task.simulation.set_joints(joints)
        return {name: task.cameras.image(name) for name in self.options.observed_cameras}

    def software_versions(self) -> dict[str, str]:
        """Returns `lerobot_adamanip.contract.versions.software_versions` and the ``renderer``, by name.

        The renderer is the source of observations. Does not start the simulator.
        """
        return {**software_versions(), "renderer": sensors_name(self.options)}

    def hidden_state(self) -> dict[str, Any]:
        """Returns the hidden state, for the static expert and records only."""
        return self.episode.task.simulation.hidden_state()

    def episode_record(self) -> dict[str, Any]:
        """Returns the record of the episode up to its end, JSON-serialisable; see `EpisodeRecord`."""
        return (self.episode.end or self.episode.record()).to_json()

    def camera_parameters(self) -> dict[str, Any]:
        """Returns the front camera's calibration, JSON-serialisable; see `sim.raycast.camera_parameters`."""
        return self.episode.task.cameras.parameters()
