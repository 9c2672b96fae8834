"""Options of the twin: its robot, its camera, and the scripted teleoperator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT, image_column
from lerobot_adamanip.contract.control import DENSE, KEYFRAME
from lerobot_adamanip.contract.schema import IMAGE_SIZE, MAX_KEY_FRAMES
from lerobot_adamanip.contract.sensing import EXACT
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
from lerobot_adamanip.hardware.teleoperators.config_devices import TcpTeleopConfig
from lerobot_adamanip.util.errors import ConfigurationError, require_choice, shown_by_parsers

CLOCKS = ("realtime", "lockstep")


@CameraConfig.register_subclass("adamanip_twin")
@dataclass(kw_only=True)
class AdamanipTwinConfig(CameraConfig):
    """A camera of the twin's scene, named by its key in ``--robot.cameras``: front or wrist. The robot sets its size.

    ``fps`` is its rate in real time (default 10: a picture takes about 50 ms of CPU time). In lockstep it takes one
    picture per observation. ``width`` and ``height`` must be the twin's, if set.
    """

    use_rgb: bool = True
    """Whether frames have colour."""

    use_depth: bool = False
    """Whether frames have depth, of the same moment. Only the front camera can."""


@TeleoperatorConfig.register_subclass("adamanip_scripted")
@dataclass(kw_only=True)
class AdamanipScriptedConfig(TcpTeleopConfig):
    """Plays this project's adaptive expert on the twin at human speed. It is idle after the expert has ended."""

    speed: float = 0.2
    """Peak speed of each motion [m/s]."""

    angular_speed: float = 0.8
    """Peak angular speed of each motion [rad/s]."""

    pause: float = 0.3
    """Pause between two motions [s], similar to a person's."""

    trials: int = 1
    """Failed tries before the expert changes its hypothesis."""

    seed: int = 0
    """Seed of the expert's random choices, together with the episode's."""

    stay: float = 0.5
    """Time from the expert's end to the end of the recorded episode [s]."""


@RobotConfig.register_subclass("adamanip_franka_sim")
@dataclass(kw_only=True)
class AdamanipFrankaSimConfig(AdamanipFrankaConfig):
    """A simulated arm with one of this project's objects, with the feature names of the real arm. See docs/twin.md.

    Options that only concern a real arm (address, dynamics, stiffness ...) have no effect.
    """

    category: str = "microwave"
    """Category of the object: bottle ... lamp."""

    objects: str = "seen"
    """Objects: seen, unseen, FIRST:END or ids. Each episode draws one with its seed."""

    assets: str | None = None
    """Folder of external assets, used instead of generated objects."""

    split: str = "validation"
    """Scene split of the seeds: validation, test or train."""

    poses: str = "randomized"
    """Poses: randomized, or fixed as in upstream's code."""

    mechanism_rules: str = "paper"
    """Rules of mechanisms: paper, upstream, hard, row or changing."""

    sensing: str = EXACT
    """Errors of depth, of the cameras' poses and of joint torques: exact, d435, rough, or one of them with single parts
    changed, e.g. d435,camera_error_mm=15. Errors of the arm and latency have no effect."""

    hidden: dict[str, Any] = field(default_factory=dict)
    """Fixed hidden values, e.g. '{locked: true}'. The others are drawn with the seed."""

    seed: int = 0
    """Seed of the first episode. Episode k of a recording has seed + k."""

    clock: str = "realtime"
    """Clock. realtime: the machine's clock. lockstep: each action advances 1/fps, with equal data on every machine."""

    fps: float | None = None
    """Rate of the loop [Hz], for lockstep: one step takes 1/fps. Default: that of LeRobot's command."""

    camera: bool = True
    """Whether the twin has cameras: those of the command's policy, else all. Without them nothing is rendered."""

    camera_hz: int = 10
    """Rate of each camera in real time [Hz]."""

    image_size: int | None = None
    """Side length of the cameras' pictures [px]. Default: that of the command's policy, else 256."""

    image_source: str | None = None
    """Source of pictures: raycast, or render with a Vulkan device. Default: that of the simulated demonstrations,
    raycast in stream mode and render in key frames."""

    render_backend: str = "auto"
    """Device of the renderer: auto, cuda or cpu."""

    episode_log: str | None = None
    """Log file with success and hidden values, one JSON line per episode. Recordings write one next to the dataset."""

    max_key_frames: int = MAX_KEY_FRAMES
    """Maximum key frames of an episode with execution=keyframe. Actions after that or after success have no effect."""

    end_when_done: bool = False
    """Whether to end the command, like Ctrl-C, when the task succeeds, or after max_key_frames with execution=keyframe.
    Otherwise a rollout ends after --duration only, or never."""

    box_lower: tuple[float, float, float] | None = (-0.3, -1.0, -0.2)
    """Lowest corner of the box [m, base frame]. It contains all that the arm reaches, since nothing can break."""

    box_upper: tuple[float, float, float] | None = (1.3, 1.0, 1.5)
    """Highest corner of the box [m, base frame]."""

    speed: float = 0.3
    """Maximum speed of a streamed target [m/s]."""

    angular_speed: float = 1.2
    """Maximum angular speed of a streamed target [rad/s]."""

    state_age: float = 5.0
    """Maximum age of the arm's state [s]. A slow picture may delay it without danger."""

    camera_age: float = 2.0
    """Maximum age of a camera frame [s]."""

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for an invalid option."""
        if self.cameras:
            self.image_size = self.image_size or IMAGE_SIZE
            self._complete_cameras()
        super().__post_init__()
        with shown_by_parsers():
            require_choice("clock", self.clock, CLOCKS, hint="--robot.clock=lockstep")
            for name, camera in self.cameras.items():
                if isinstance(camera, AdamanipTwinConfig):
                    require_choice("camera of the twin", name, CAMERAS)
            if not 0 <= self.seed < 2**31 or not 1 <= (self.fps or 1) <= 1000:
                raise ConfigurationError(
                    "Wrong seed or rate.", got=f"seed {self.seed}, fps {self.fps}", allowed="seed >= 0, fps 1 ... 1000"
                )
            self.environment()

    def set_cameras(self, *, depth: bool, images: Mapping[str, tuple[int, ...]]) -> None:
        """Sets the cameras and the size of pictures, unless there are any.

        Args:
            depth: whether the front camera has depth.
            images: column -> (C, H, W) of the images that a policy reads.
        """
        views = {name: images[image_column(name)] for name in CAMERAS if image_column(name) in images}
        self.image_size = self.image_size or next((shape[-1] for shape in views.values()), IMAGE_SIZE)
        if self.camera and not self.cameras:
            names = (
                dict.fromkeys([*views, *([FRONT] if depth else [])]) if views else self.environment().observed_cameras
            )
            self.cameras = {name: AdamanipTwinConfig(use_depth=depth and name == FRONT) for name in names}
            self._complete_cameras()

    def _complete_cameras(self) -> None:
        for camera in self.cameras.values():
            if isinstance(camera, AdamanipTwinConfig):
                camera.width, camera.height = camera.width or self.image_size, camera.height or self.image_size
                camera.fps = camera.fps or self.camera_hz

    def environment(self) -> EnvironmentOptions:
        """Returns the options of the scenes. Raises `ConfigurationError`."""
        return EnvironmentOptions(
            control=KEYFRAME if self.execution == KEYFRAME else DENSE,
            image_source=self.image_source,
            category=self.category,
            objects=self.objects,
            assets=self.assets,
            split=self.split,
            poses=self.poses,
            mechanism_rules=self.mechanism_rules,
            sensing=self.sensing,
            hidden_overrides=self.hidden,
            image_size=self.image_size or IMAGE_SIZE,
            render_backend=self.render_backend,
            max_key_frames=self.max_key_frames,
            observe_images=False,
        )
