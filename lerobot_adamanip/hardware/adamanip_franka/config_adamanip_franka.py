"""Options of the real arm."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig

from lerobot_adamanip.hardware.backends.franky_options import FrankyOptions
from lerobot_adamanip.hardware.limits import MODELS
from lerobot_adamanip.util.errors import require_choice, shown_by_parsers

EXECUTIONS = ("keyframe", "stream")


@RobotConfig.register_subclass("adamanip_franka")
@dataclass(kw_only=True)
class AdamanipFrankaConfig(FrankyOptions, RobotConfig):
    """A Franka with its hand, see docs/robot.md. Address, model and box have to be given."""

    box_lower: tuple[float, float, float] | None = None
    """Lowest corner [m, base frame] of the box; its z is the floor. Targets, and the way of a key frame, keep the tool
    and the whole hand in it. An arm that gives way or is pushed may leave it by what its compliance allows."""

    box_upper: tuple[float, float, float] | None = None
    """Its highest corner."""

    execution: str = "stream"
    """stream: the newest action wins, nothing waits (teleoperate, record). keyframe: an action is one motion to its end
    (rollout, replay of key frames)."""

    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """By key; the one whose depth becomes the cloud is called front."""

    speed: float = 0.10
    """Of a streamed target [m/s]."""

    angular_speed: float = 0.4
    """Of a streamed target [rad/s]."""

    lead: float = 0.04
    """Of a streamed target over the measured pose [m]: times the stiffness, the force of a pull."""

    angular_lead: float = 0.15
    """Likewise [rad]."""

    state_age: float = 0.2
    """The arm's state may be this old [s]; then it is stopped, and that is an error. From 1 s up a connection that
    stands still may be told a second later: libfranka waits so long for an answer."""

    command_age: float = 0.5
    """Streamed actions may stop this long [s]; then the arm holds where it is."""

    camera_age: float = 0.5
    """A camera's frame may be this old [s]; then an error."""

    motion_time: float = 60.0
    """A key frame, with its grip, takes no longer than this [s]; then an error."""

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for what cannot be meant."""
        RobotConfig.__post_init__(self)
        with shown_by_parsers():
            require_choice("execution", self.execution, EXECUTIONS)
            if self.model:
                require_choice("model of arm", self.model, MODELS)
