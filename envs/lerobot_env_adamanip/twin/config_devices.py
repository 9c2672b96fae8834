"""Options of the twin: its robot, its camera, and the teleoperator that plays experts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.contract.schema import IMAGE_SIZE, MAX_KEY_FRAMES
from lerobot_adamanip.episode.options import EnvironmentOptions, refuse_former_name
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
from lerobot_adamanip.hardware.teleoperators.config_devices import TcpTeleopConfig
from lerobot_adamanip.util.errors import ConfigurationError, require_choice, shown_by_parsers

CLOCKS = ("realtime", "lockstep")
DEPTH_SOURCES = ("render", "raycast")
FRONT = "front"
"""Key of the twin's one camera."""


@CameraConfig.register_subclass("adamanip_twin")
@dataclass(kw_only=True)
class AdamanipTwinConfig(CameraConfig):
    """The front camera of the twin's scene, colour and depth of one moment. Its size is the robot's to say.

    ``fps`` is its rate in real time (default 10: a picture takes some 50 ms of a processor); in lockstep it takes
    one per observation. ``width`` and ``height`` are the twin's; others are refused.
    """

    use_rgb: bool = True
    """Whether frames have colour."""

    use_depth: bool = True
    """Whether frames have depth."""


@TeleoperatorConfig.register_subclass("adamanip_scripted")
@dataclass(kw_only=True)
class AdamanipScriptedConfig(TcpTeleopConfig):
    """Plays this project's adaptive expert on the twin, at human speed; idle once it has nothing more to do."""

    speed: float = 0.2
    """Peak of each motion [m/s]."""

    angular_speed: float = 0.8
    """Likewise [rad/s]."""

    pause: float = 0.3
    """Between two motions [s], as a person looks before going on."""

    trials: int = 1
    """Failed tries before the expert changes its hypothesis."""

    seed: int = 0
    """Seed of the expert's random choices, together with the episode's."""

    stay: float = 0.5
    """Time from the expert's end to the end of the recorded episode [s]."""


@RobotConfig.register_subclass("adamanip_franka_sim")
@dataclass(kw_only=True)
class AdamanipFrankaSimConfig(AdamanipFrankaConfig):
    """The simulated arm before one of this project's objects, behind the names of the real one. See docs/twin.md.

    Options of a real arm alone (address, dynamics, stiffness ...) have no effect.
    """

    category: str = "microwave"
    """bottle ... lamp."""

    objects: str = "seen"
    """seen, unseen, FIRST:END or ids; an episode's is drawn from its seed."""

    assets: str | None = None
    """Folder of external assets to use instead."""

    split: str = "validation"
    """Whose scenes seeds stand for: validation, test or train."""

    poses: str = "randomized"
    """randomized, or fixed as upstream's code has them."""

    mechanism_rules: str = "paper"
    """paper, upstream or hard."""

    mechanism_preset: str | None = None
    """Former name of mechanism_rules; setting it is an error that says so."""

    hidden: dict[str, Any] = field(default_factory=dict)
    """Fixed hidden values, '{locked: true}'; what is left out is drawn from the seed."""

    seed: int = 0
    """Of the first episode; episode k of a recording has seed + k."""

    clock: str = "realtime"
    """realtime: the machine's clock. lockstep: each action advances time by 1/fps: the same data on every machine."""

    fps: float = 30.0
    """Of the command's loop, in lockstep: what a step is one part of."""

    camera: bool = True
    """Whether there is a camera; without one nothing renders."""

    camera_hz: int = 10
    """How often it looks in realtime."""

    image_size: int = IMAGE_SIZE
    """Side of its pictures [px]."""

    depth_source: str = "render"
    """render, or raycast where there is no Vulkan device: then colours are missing."""

    render_backend: str = "auto"
    """auto, cuda or cpu."""

    episode_log: str | None = None
    """JSON lines, one per episode, with success and what was hidden; a recording writes one beside its dataset."""

    max_key_frames: int = MAX_KEY_FRAMES
    """Under execution=keyframe the episode is over after so many, or with success; what comes then is not executed."""

    end_when_done: bool = False
    """End the command, as Ctrl-C does, when such an episode is over: a roll-out would go on for ever."""

    box_lower: tuple[float, float, float] | None = (-0.3, -1.0, -0.2)
    """Nothing here breaks: the box holds all that the arm reaches."""

    box_upper: tuple[float, float, float] | None = (1.3, 1.0, 1.5)
    """Its highest corner."""

    speed: float = 0.3
    """Of a streamed target [m/s]."""

    angular_speed: float = 1.2
    """Of a streamed target [rad/s]."""

    state_age: float = 5.0
    """A picture that takes long delays the twin's state; nothing is in danger meanwhile."""

    camera_age: float = 2.0
    """Likewise its pictures."""

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for what cannot be meant."""
        if self.camera and not self.cameras:
            self.cameras = {FRONT: AdamanipTwinConfig()}
        for camera in self.cameras.values():
            if isinstance(camera, AdamanipTwinConfig):
                camera.width, camera.height = camera.width or self.image_size, camera.height or self.image_size
                camera.fps = camera.fps or self.camera_hz
        super().__post_init__()
        with shown_by_parsers():
            refuse_former_name("mechanism_preset", self.mechanism_preset)
            require_choice("clock", self.clock, CLOCKS, hint="--robot.clock=lockstep")
            require_choice("source of depth", self.depth_source, DEPTH_SOURCES, hint="--robot.depth_source=raycast")
            if not 0 <= self.seed < 2**31 or not 1 <= self.fps <= 1000:
                raise ConfigurationError(
                    "Wrong seed or rate.", got=f"seed {self.seed}, fps {self.fps}", allowed="seed >= 0, fps 1 ... 1000"
                )
            self.environment()

    def environment(self) -> EnvironmentOptions:
        """Returns the scenes. Raises `ConfigurationError`."""
        return EnvironmentOptions(
            category=self.category,
            objects=self.objects,
            assets=self.assets,
            split=self.split,
            poses=self.poses,
            mechanism_rules=self.mechanism_rules,
            hidden_overrides=self.hidden,
            image_size=self.image_size,
            render_backend=self.render_backend,
            observe_images=False,
        )
