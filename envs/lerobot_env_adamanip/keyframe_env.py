"""Environment for LeRobot: one step is one key frame."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import __version__
from lerobot_adamanip.contract.cameras import CAMERAS, FRONT
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import Feedback, KeyFrameLabels
from lerobot_adamanip.contract.observation import state_vector, workspace_cloud
from lerobot_adamanip.contract.pointcloud import depth_size
from lerobot_adamanip.contract.schema import FPS
from lerobot_adamanip.contract.seeds import retried_seed, scene_seed
from lerobot_adamanip.contract.versions import SIMULATION_VERSION, installed_versions, software_versions
from lerobot_adamanip.episode.options import EnvironmentOptions, require_known
from lerobot_adamanip.evaluation.record import EpisodeRecord, Provenance, new_run_id
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.util.errors import SimulatorError, UnreachableError, require_choice
from lerobot_env_adamanip.episode_log import EpisodeLog, EpisodeMonitor
from lerobot_env_adamanip.gym_interface import (
    RENDER_MODE,
    action_space,
    clipped,
    environment_spec,
    observation_space,
    reset_options,
)
from lerobot_env_adamanip.sim.render_device import observes_images
from lerobot_env_adamanip.simulator import make_task, sensors_name

if TYPE_CHECKING:  # the simulator is imported at the first reset
    from lerobot_env_adamanip.sim.tasks import AdaManipTask

Observation = dict[str, Any]
SCENE_TRIES = 4
"""Maximum number of scenes that a reset tries: the seed's own, then others derived from the seed."""
_logger = logging.getLogger(__name__)


class KeyframeEnv(gym.Env[Observation, NDArray[np.float32]]):
    """AdaManip environment with key frames as steps. The simulator starts with the first reset.

    Action: (10,) next tool pose, robot base frame: position [m], rotation 6D, gripper [0 closed, 1 open].
    Observation: ``point_cloud`` (N, 3) [m], ``agent_pos`` (24,), ``effort`` (7,) [N m], and ``pixels["front"]``
        (H, W, 3) if images are observed, see ``observe_images``. All bounds are finite.
    Info, of reset and of each step: ``is_success`` (bool), and ``limit`` (str), the reason of a truncation or an empty
        text. It holds no hidden state.
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
        self.spec = environment_spec(asked)
        self.options = asked
        if asked.observe_images is None:
            self.options = asked.changed(observe_images=observes_images(None))
        self.category, self.num_points = self.options.category, self.options.num_points
        self.workspace = self.options.workspace
        self.task = self.task_description = CATEGORIES[self.category].instruction
        self.render_mode = render_mode
        self._max_episode_steps = self.options.max_key_frames  # name required by LeRobot
        self._sim: AdaManipTask | None = None
        self._monitor: EpisodeMonitor | None = None
        self._record: EpisodeRecord | None = None
        self._seeds: dict[str, int] = {}
        self._limit = ""
        self._episode_log, self._provenance = _log_of(self.options)
        self._image: NDArray[np.uint8] | None = None
        self._renders = True
        self.action_space = action_space()
        self.observation_space = observation_space(self.options)

    # Gymnasium --------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode. ``seed`` determines object, poses and hidden state; equal seeds give equal episodes.

        The seed is mapped into the environment's split. If the arm cannot reach its scene, other scenes derived from
        the seed are tried; the log records this.

        Options: ``object_id`` selects an object of the category; ``hidden_overrides`` fixes hidden values. LeRobot's
        option of a new rollout has no effect.

        Raises:
            ConfigurationError: the option, object or hidden value does not exist.
            UnreachableError: the arm cannot reach the part in any of the scenes.
        """
        self._monitor = self._record = self._image = None  # after a failed reset there is no episode
        self._limit = ""
        chosen = reset_options(self.options, options or {})
        super().reset(seed=seed)
        given = seed if seed is not None else int(self.np_random.integers(2**31))
        wanted = scene_seed(given + self.options.seed_offset, self.options.split)
        sim = self._started()
        drawn = self._placed(sim, wanted, chosen)
        self._seeds = {"seed": drawn, "given_seed": given}
        self.restart_episode()
        return self.observe(), self._info(False)

    def restart_episode(self) -> None:
        """Starts counting key frames and tries in the present state, as at a reset: for late starts."""
        sim = self._sim
        assert sim is not None
        sim.restart_tries()
        self._record = None
        self._monitor = EpisodeMonitor(sim, **self._seeds, provenance=self._provenance, options=self.options)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Moves the arm to the commanded pose and observes. Raises `ConfigurationError` for a malformed action."""
        had_succeeded = self._episode().success
        success, truncated = self.drive(action)
        reward = float(success and not had_succeeded)
        return self.observe(), reward, success, truncated, self._info(success)

    def end_episode(self, limit: str) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Ends the episode without success for a reason of the caller's, and observes, as `step` does at a limit.

        An episode that has ended keeps its result.
        """
        if self._record is None:
            self._end(self._episode(), limit)
        success, truncated = self._result()
        return self.observe(), 0.0, success, truncated, self._info(success)

    def drive(self, action: NDArray[np.float32]) -> tuple[bool, bool]:
        """Runs `step` without an observation; returns whether the task is done, and whether a limit is reached."""
        sim, monitor = self._running(), self._episode()
        sim.execute(np.asarray(action))
        self._image = None
        monitor.after_key_frame()
        if self._record is None and (monitor.success or monitor.limit is not None):
            self._end(monitor, "" if monitor.success else str(monitor.limit))
        return self._result()

    def _end(self, monitor: EpisodeMonitor, limit: str) -> None:
        """Fixes the record of the episode and logs it."""
        self._limit, self._record = limit, monitor.record()
        if self._episode_log is not None:
            self._episode_log.append(self._record)

    def _result(self) -> tuple[bool, bool]:
        """Returns whether the episode has succeeded, and whether it was truncated."""
        success = self._record is not None and self._record.success
        return success, self._record is not None and not success

    def _info(self, success: bool) -> dict[str, Any]:
        """Returns the info of a reset or step: always the same keys."""
        return {"is_success": success, "limit": self._limit, "goal_clipped": self._running().feedback.is_clipped}

    def observe(self) -> Observation:
        """Returns the present observation."""
        seen = self._running().observe(image=bool(self.options.observe_images))
        self._image = seen.images.get(FRONT)
        spaces: Any = self.observation_space
        observation: Observation = {
            "agent_pos": clipped(state_vector(seen.feedback, seen.qpos, seen.qvel), spaces["agent_pos"]),
            "effort": clipped(seen.effort.astype(np.float32), spaces["effort"]),
            "point_cloud": workspace_cloud(seen.points_in_base, self.workspace, self.num_points),
        }
        return {**observation, "pixels": seen.images} if seen.images else observation

    def render(self) -> NDArray[np.uint8]:
        """Returns the front camera's present image (H, W, 3); black before the first episode.

        Without a Vulkan device it shows shaded shapes without colours, with a warning.
        """
        size = self.options.image_size
        if self._image is None:
            self._image = np.zeros((size, size, 3), np.uint8) if self._monitor is None else self._picture()
        return self._image.copy()

    def _picture(self) -> NDArray[np.uint8]:
        sim = self._running()
        if self._renders:
            try:
                return sim.views.image()
            except SimulatorError as error:
                self._renders = False
                _logger.warning("Videos show shapes without colours: %s", str(error).split("\n")[0])
        return sim.views.shaded_image()

    def close(self) -> None:
        """Ends the simulator."""
        if self._sim is not None:
            self._sim.close()
            self._sim = self._monitor = self._record = None

    # For experts, recorders and reports: `lerobot_adamanip.episode.rollout` -----------------------------------------

    @property
    def max_key_frames(self) -> int:
        """Maximum key frames per episode."""
        return self._max_episode_steps

    @property
    def feedback(self) -> Feedback:
        """Feedback of the latest key frame."""
        return self._running().feedback

    @property
    def labels(self) -> KeyFrameLabels:
        """Labels of the latest key frame; not for policies or experts."""
        return self._episode().labels

    @property
    def annotations(self) -> dict[str, PartAnnotation]:
        """Annotated part poses at the episode's start, robot base frame."""
        return self._running().placement.annotations

    def part_positions(self) -> dict[str, float]:
        """Returns the object's present joint positions [rad or m]."""
        return self._running().joint_positions()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the object's joints in the order of `labels`: the opening joint first."""
        return self._running().mechanism.joints

    def joints(self) -> NDArray[np.float32]:
        """Returns the positions of all joints, (13,), see `schema.JOINT_NAMES`; for records."""
        return self._running().views.joints()

    def pictures_at(self, joints: NDArray[np.float32]) -> dict[str, NDArray[np.uint8]]:
        """Returns each camera's image (H, W, 3) with all joints at ``joints`` (13,), at rest; raises `SimulatorError`.

        The episode cannot continue afterwards.
        """
        views = self._running().views
        views.set_joints(joints)
        return {name: views.image(name) for name in CAMERAS}

    def software_versions(self) -> dict[str, str]:
        """Returns `lerobot_adamanip.contract.versions.software_versions` and the ``renderer``, by name.

        The renderer is the source of observations. Does not start the simulator.
        """
        return {**software_versions(), "renderer": sensors_name(self.options)}

    def hidden_state(self) -> dict[str, Any]:
        """Returns the hidden state, for the static expert and records only."""
        return self._running().hidden_state()

    def episode_record(self) -> dict[str, Any]:
        """Returns the record of the episode up to its end, JSON-serialisable; see `EpisodeRecord`."""
        return (self._record or self._episode().record()).to_json()

    def camera_parameters(self) -> dict[str, Any]:
        """Returns the front camera's calibration, JSON-serialisable; see `sim.camera.camera_parameters`."""
        return self._running().views.camera_parameters()

    # Inside -----------------------------------------------------------------------------------------------------

    def _started(self) -> AdaManipTask:
        if self._sim is None:
            shared = ("objects", "assets", "poses", "mechanism_rules", "image_size", "cloud_source", "workspace")
            self._sim = make_task(
                self.category,
                **{name: getattr(self.options, name) for name in (*shared, "render_backend")},
                hidden_overrides=dict(self.options.hidden_overrides),
                depth_size=depth_size(self.num_points),
                shader="minimal",  # three quarters of the time of ManiSkill's default, without a GPU
            )
        return self._sim

    def _placed(self, sim: AdaManipTask, seed: int, chosen: dict[str, Any]) -> int:
        """Resets the simulator to a reachable scene; returns its seed."""
        first, attempt = seed, 0
        is_one_object = "object_id" in chosen or len(sim.object_ids) == 1
        while True:
            try:
                sim.reset(seed=seed, options={"reconfigure": True, **chosen})
                return seed
            except UnreachableError as error:
                attempt += 1
                if attempt == SCENE_TRIES or (error.is_certain and is_one_object):
                    raise
                seed = retried_seed(first, self.options.split, attempt)
                _logger.warning("Seed %d: %s Another scene is drawn: seed %d.", first, str(error).split("\n")[0], seed)

    def _episode(self) -> EpisodeMonitor:
        if self._monitor is None:
            raise gym.error.ResetNeeded("No episode is running: call reset() first.")
        return self._monitor

    def _running(self) -> AdaManipTask:
        self._episode()
        assert self._sim is not None
        return self._sim


def _log_of(options: EnvironmentOptions) -> tuple[EpisodeLog | None, Provenance]:
    """Returns an environment's log and its episodes' provenance. Without a log they belong to no evaluation."""
    log = None if options.episode_log is None else EpisodeLog(Path(options.episode_log), options.logged_seeds)
    run_id = None if log is None else options.run_id or new_run_id()
    made = Provenance(SIMULATION_VERSION, __version__, options.mechanism_rules, run_id, options.run_label)
    return log, replace(made, versions=installed_versions())
