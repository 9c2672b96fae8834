"""The environment LeRobot sees: one step is one key frame, one observation is one rendered view."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import __version__
from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.errors import (
    AdaManipError,
    ConfigurationError,
    SimulatorError,
    no_vulkan_device,
    require_choice,
)
from lerobot_adamanip.evaluation.log import new_run_id
from lerobot_adamanip.evaluation.record import Provenance
from lerobot_adamanip.keyframes import Feedback, KeyFrameLabels
from lerobot_adamanip.mechanisms import MECHANISM_PRESETS
from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.observation import state_vector, workspace_cloud
from lerobot_adamanip.pointcloud import DEFAULT_WORKSPACE, Workspace, check_num_points
from lerobot_adamanip.schema import (
    ACTION_DIM,
    DEFAULT_NUM_POINTS,
    FPS,
    IMAGE_SIZE,
    MAX_KEY_FRAMES,
    NUM_JOINTS,
    STATE_DIM,
)
from lerobot_env_adamanip.episode_log import EpisodeLog, EpisodeMonitor
from lerobot_env_adamanip.fingerprint import present_fingerprint
from lerobot_env_adamanip.sim.placement import randomization

if TYPE_CHECKING:  # the simulator is imported at the first reset
    from lerobot_env_adamanip.sim.tasks import AdaManipTask

Observation = dict[str, Any]


class KeyframeEnv(gym.Env[Observation, NDArray[np.float32]]):
    """AdaManip at key frames. The simulator starts with the first reset, so that building one costs nothing.

    Action: (10,) next tool pose, robot base frame: position [m], rotation 6D, gripper [0 closed, 1 open].
    Observation: ``point_cloud`` (N, 3), ``agent_pos`` (24,), ``effort`` (7,), and ``pixels["front"]`` (H, W, 3)
        unless ``observe_images`` is off. Reset and step info hold ``is_success`` (bool) and nothing that is hidden.
    Reward: 1 on the key frame that succeeds. An episode ends there, or after ``max_key_frames``.

    Args:
        category: ``bottle`` ... ``lamp``, see `lerobot_adamanip.categories`.
        objects: which ones: ``seen``, ``unseen``, ``FIRST:END`` or ids; an episode's is drawn from its seed.
        assets: a folder of objects of others (AdaManip's, UniDoorManip's, PartNet-Mobility's), to use instead of
            generated ones; then ``seen`` means all of them.
        num_points: N.
        image_size: of the front camera [px].
        observe_images: whether observations hold the image.
        pose_preset: ``default`` randomises object, robot and camera pose; ``paper`` fixes them.
        mechanism_preset: ``paper`` follows the paper's text, ``upstream`` its released code.
        max_key_frames: length limit.
        hidden_overrides: fixed hidden values, ``{"locked": True}``, for evaluation and tests.
        episode_log: a file to which each ended episode's record is appended as a line of JSON.
        run_id: of the evaluation that those records belong to; drawn anew if left out.
        run_label: what to call it in reports, for instance the policy.
        workspace: what of the scene the cloud keeps.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012  (Gymnasium declares it so)

    def __init__(
        self,
        category: str = "safe",
        *,
        objects: str = "seen",
        assets: str | os.PathLike[str] | None = None,
        num_points: int = DEFAULT_NUM_POINTS,
        image_size: int = IMAGE_SIZE,
        observe_images: bool = True,
        pose_preset: str = "default",
        mechanism_preset: str = "paper",
        max_key_frames: int = MAX_KEY_FRAMES,
        hidden_overrides: dict[str, Any] | None = None,
        episode_log: str | os.PathLike[str] | None = None,
        run_id: str | None = None,
        run_label: str | None = None,
        workspace: Workspace = DEFAULT_WORKSPACE,
    ) -> None:
        select_objects(category, objects, assets)
        randomization(pose_preset)
        require_choice("mechanism preset", mechanism_preset, MECHANISM_PRESETS)
        _check_range("image size [px]", image_size, 16, 2048, "--env.image_size=256")
        _check_range("number of key frames per episode", max_key_frames, 1, 10_000, "--env.episode_length=45")
        self.category, self.num_points, self.workspace = category, check_num_points(num_points), workspace
        self.task = self.task_description = CATEGORIES[category].instruction
        self.render_mode = "rgb_array"
        self._max_episode_steps = self.max_key_frames = max_key_frames
        self._observe_images = observe_images
        self._episode_log = EpisodeLog(Path(episode_log)) if episode_log else None
        run_id = (run_id or new_run_id()) if episode_log else None  # a recorded episode belongs to no evaluation
        self._provenance = Provenance(present_fingerprint(), __version__, run_id, run_label)
        self._task_options = {
            "objects": objects,
            "assets": None if assets is None else str(assets),
            "pose_preset": pose_preset,
            "mechanism_preset": mechanism_preset,
            "image_size": image_size,
            "hidden_overrides": hidden_overrides,
        }
        self._sim: AdaManipTask | None = None
        self._monitor: EpisodeMonitor | None = None
        self._image: NDArray[np.uint8] = np.zeros((image_size, image_size, 3), np.uint8)
        self.action_space = gym.spaces.Box(-np.inf, np.inf, (ACTION_DIM,), np.float32)
        unbounded = {"agent_pos": (STATE_DIM,), "effort": (NUM_JOINTS,), "point_cloud": (num_points, 3)}
        spaces: dict[str, gym.Space[Any]] = {
            key: gym.spaces.Box(-np.inf, np.inf, shape, np.float32) for key, shape in unbounded.items()
        }
        if observe_images:
            spaces["pixels"] = gym.spaces.Dict({"front": gym.spaces.Box(0, 255, self._image.shape, np.uint8)})
        self.observation_space = gym.spaces.Dict(spaces)

    # Gymnasium --------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode. ``seed`` decides object, poses and hidden state; equal seeds give equal episodes.

        Options: ``object_id`` chooses the object; ``hidden_overrides`` fixes hidden values. Others are ignored.
        """
        super().reset(seed=seed)
        episode_seed = seed if seed is not None else int(self.np_random.integers(2**31))
        sim = self._started()
        self._monitor = None  # a reset that fails leaves no episode to go on with
        wanted = {key: value for key, value in (options or {}).items() if key in ("object_id", "hidden_overrides")}
        sim.reset(seed=episode_seed, options={"reconfigure": True, **wanted})
        self._monitor = EpisodeMonitor(sim, sim.placement.annotations, seed=episode_seed, provenance=self._provenance)
        return self._observe(), {"is_success": False}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drives the arm to the commanded pose and observes. Raises `ConfigurationError` for a malformed action."""
        sim, monitor = self._running(), self._episode()
        sim.execute(np.asarray(action))
        had_ended = monitor.success or monitor.key_frames >= self._max_episode_steps
        success = monitor.after_key_frame()
        truncated = not success and monitor.key_frames >= self._max_episode_steps
        if (success or truncated) and not had_ended and self._episode_log is not None:
            self._episode_log.append(monitor.record())
        return self._observe(), float(success), success, truncated, {"is_success": success}

    def render(self) -> NDArray[np.uint8]:
        """Returns the front camera's latest image (H, W, 3)."""
        return self._image.copy()

    def close(self) -> None:
        """Ends the simulator."""
        if self._sim is not None:
            self._sim.close()
            self._sim = self._monitor = None

    # For experts, recorders and reports ---------------------------------------------------------------------------

    @property
    def feedback(self) -> Feedback:
        """What was felt at the latest key frame."""
        return self._running().feedback

    @property
    def labels(self) -> KeyFrameLabels:
        """What the latest key frame tried, and what came of it: not for policies or experts."""
        return self._episode().labels

    @property
    def annotations(self) -> dict[str, PartAnnotation]:
        """Annotated part poses at the episode's start, robot base frame."""
        return self._running().placement.annotations

    def hidden_state(self) -> dict[str, Any]:
        """Returns the hidden state: privileged; for the static expert and records only."""
        return self._running().hidden_state()

    def episode_record(self) -> dict[str, Any]:
        """Returns what is worth keeping of the episode so far, JSON-able; see `EpisodeRecord`."""
        return self._episode().record().to_json()

    def camera_parameters(self) -> dict[str, Any]:
        """Returns intrinsics (3, 3) [px], camera pose in the base frame (4, 4, OpenCV axes) and size, JSON-able."""
        return self._running().camera_parameters().to_json()

    # Inside -----------------------------------------------------------------------------------------------------

    def _started(self) -> AdaManipTask:
        if self._sim is None:
            self._sim = make_task(self.category, **self._task_options)
        return self._sim

    def _episode(self) -> EpisodeMonitor:
        if self._monitor is None:
            raise gym.error.ResetNeeded("No episode is running: call reset() first.")
        return self._monitor

    def _running(self) -> AdaManipTask:
        self._episode()
        assert self._sim is not None
        return self._sim

    def _observe(self) -> Observation:
        seen = self._running().observe()
        self._image = seen.image
        observation: Observation = {
            "agent_pos": state_vector(seen.feedback, seen.qpos, seen.qvel),
            "effort": seen.effort.astype(np.float32),
            "point_cloud": workspace_cloud(seen.points_in_base, self.workspace, self.num_points),
        }
        if self._observe_images:
            observation["pixels"] = {"front": self._image}
        return observation


def _check_range(what: str, got: int, lowest: int, highest: int, hint: str) -> None:
    if not lowest <= got <= highest:
        raise ConfigurationError(f"Wrong {what}.", got=got, allowed=f"{lowest} ... {highest}", hint=hint)


def make_task(category: str, **options: Any) -> AdaManipTask:
    """Builds the ManiSkill task of a category, without observations of its own.

    Raises:
        SimulatorError: the simulator is not installed, or finds nothing to render with.
    """
    try:
        import mani_skill.envs  # noqa: F401  (ManiSkill's own tasks, and its registry)

        import lerobot_env_adamanip.sim.tasks  # noqa: F401  (registers the tasks)
    except ImportError as error:
        raise SimulatorError(
            "The simulator is not installed.",
            got=error,
            allowed="mani-skill 3.0.1 and sapien 3.0.3",
            hint="pip install 'lerobot_env_adamanip[sim]'",
        ) from error
    try:
        made = gym.make(CATEGORIES[category].task_id, obs_mode="none", reward_mode="none", **options).unwrapped
    except RuntimeError as error:
        if isinstance(error, AdaManipError) or not any(
            word in str(error).lower() for word in ("vulkan", "vk", "render", "device", "extension")
        ):
            raise
        raise no_vulkan_device(error) from error
    return cast("AdaManipTask", made)
