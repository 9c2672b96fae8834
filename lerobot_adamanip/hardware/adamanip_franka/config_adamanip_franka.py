"""Options of the real arm."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig

from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, POSE, STATES
from lerobot_adamanip.contract.memory import EVENTS, NO_MEMORY
from lerobot_adamanip.hardware.backends.franky_options import MODELS, FrankyOptions
from lerobot_adamanip.util.errors import require_choice, shown_by_parsers

EXECUTIONS = ("keyframe", "stream")


@RobotConfig.register_subclass("adamanip_franka")
@dataclass(kw_only=True)
class AdamanipFrankaConfig(FrankyOptions, RobotConfig):
    """A Franka arm with its hand, see docs/robot.md. Address, model and box are required."""

    box_lower: tuple[float, float, float] | None = None
    """Lowest corner [m, base frame] of the safety box; its z is the floor. Targets and key-frame paths keep the whole
    hand inside. A compliant arm that is pushed may still leave the box."""

    box_upper: tuple[float, float, float] | None = None
    """Highest corner [m, base frame] of the safety box."""

    execution: str = "stream"
    """How actions run. stream: each action replaces the one before (teleoperate, record). keyframe: each action is one
    complete motion (rollout, replay of key frames)."""

    action: str | None = None
    """Action in stream mode: ee_delta (7 numbers, from the measured pose) or ee_pose (10). Default: that of the
    command's policy, else ee_delta."""

    state: str | None = None
    """State in stream mode: pose (8 numbers) or full (24, with joints). Default: that of the command's policy, else
    pose."""

    depth: bool | None = None
    """Whether observations hold the cameras' depth, from which clouds are made. LeRobot's own policies fail on it.
    Default: in key frames, and for a policy that needs it."""

    memory: str = NO_MEMORY
    """Memory of felt tries in observations: events (numbers in observation.environment_state), or none. `adamanip
    memory` adds it to a recording later, also as text."""

    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """Cameras by key. The depth of the camera ``front`` becomes the point cloud."""

    self_calibration: bool = False
    """Whether to correct the calibration of a resting depth camera by the hand in its pictures, whenever the arm rests.
    A warning says if the camera has moved by more than 5 mm."""

    speed: float = 0.10
    """Maximum speed of a streamed target [m/s]."""

    angular_speed: float = 0.4
    """Maximum angular speed of a streamed target [rad/s]."""

    lead: float = 0.04
    """Maximum distance from the measured pose to a streamed target [m]. The pulling force is this times stiffness."""

    state_age: float = 0.2
    """Maximum age of the arm's state [s]. An older state stops the arm and raises an error. From 1 s up, the error may
    come a second late: libfranka waits that long for an answer."""

    command_age: float = 0.5
    """Maximum pause between streamed actions [s]. After it the arm holds its position."""

    camera_age: float = 0.5
    """Maximum age of a camera frame [s]. An older frame raises an error."""

    motion_time: float = 60.0
    """Maximum duration of a key frame with its gripper command [s]. A longer one raises an error."""

    recover_on_connect: bool = False
    """Whether connecting clears a reflex of an earlier command. Nothing moves. Look first at what the arm touched."""

    def __post_init__(self) -> None:
        """Raises `AdaManipError` for an invalid option."""
        RobotConfig.__post_init__(self)
        with shown_by_parsers():
            require_choice("execution", self.execution, EXECUTIONS)
            require_choice("memory", self.memory, (NO_MEMORY, EVENTS), hint="--robot.memory=events")
            require_choice("kind of action", self.action or EE_DELTA, ACTION_NAMES, hint="--robot.action=ee_delta")
            require_choice("kind of state", self.state or POSE, STATES, hint="--robot.state=pose")
            if self.model:
                require_choice("model of arm", self.model, MODELS)
