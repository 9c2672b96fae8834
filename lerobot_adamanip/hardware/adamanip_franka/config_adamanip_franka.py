"""Options of the real arm."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig

from lerobot_adamanip.util.errors import ConfigurationError, require_choice, shown_by_parsers

EXECUTIONS = ("auto", "keyframe", "stream")
MODELS = ("fr3", "panda")


@RobotConfig.register_subclass("adamanip_franka")
@dataclass(kw_only=True)
class AdamanipFrankaConfig(RobotConfig):
    """A Franka with its hand: what it is, where it may go, how an action is executed. See docs/robot.md.

    What has no default has to be given: nobody else knows it.
    """

    address: str = ""
    """Host name or IP address of the arm's controller."""

    model: str = ""
    """fr3 or panda (FER): decides the limits."""

    box_lower: tuple[float, float, float] | None = None
    """Lowest corner [m, base frame] of the box; its z is the floor. Targets, and the way of a key frame, keep the tool
    and the whole hand in it. An arm that gives way or is pushed may leave it by what its compliance allows."""

    box_upper: tuple[float, float, float] | None = None
    """Its highest corner."""

    execution: str = "stream"
    """stream: the newest action wins, nothing waits (teleoperate, record). keyframe: an action is one motion to its end
    (rollout, replay of key frames). auto: an action farther than a stream gets in one and a half ticks is a key frame
    (DAgger)."""

    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """By key; the one whose depth becomes the cloud is called front."""

    dynamics: float = 0.05
    """Share of the model's velocities, accelerations and jerks that motions are planned with."""

    speed: float = 0.10
    """Of a streamed target [m/s]."""

    angular_speed: float = 0.4
    """Of a streamed target [rad/s]."""

    lead: float = 0.04
    """Of a streamed target over the measured pose [m]: times the stiffness, the force of a pull."""

    angular_lead: float = 0.15
    """Likewise [rad]."""

    stiffness: float = 1000.0
    """Of the Cartesian impedance in the arm's firmware [N/m]."""

    rotational_stiffness: float = 40.0
    """Likewise [N m/rad]."""

    stall_force: float = 30.0
    """A key frame that takes more force than this is given up, and that is an outcome [N]."""

    stall_torque: float = 1.1
    """Likewise [N m]."""

    collision_force: float = 60.0
    """The arm's own reflex [N]; above what a pull may take."""

    collision_torque: float = 40.0
    """Likewise of each joint [N m]."""

    effort_sign: float = 1.0
    """1 or -1, so that `joint_i.effort` is what the arm exerts: measured once per arm, see docs/robot.md."""

    realtime: bool = True
    """Demand a real-time kernel."""

    gripper: bool = True
    """Whether Franka's hand is mounted."""

    gripper_speed: float = 0.1
    """Of the fingers [m/s]."""

    grasp_force: float = 30.0
    """[N]."""

    auto_recover: int = 0
    """Reflexes in a row that are recovered from by itself, at half dynamics; the next one ends with an error."""

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
        super().__post_init__()
        with shown_by_parsers():
            require_choice("execution", self.execution, EXECUTIONS)
            if self.model:
                require_choice("model of arm", self.model, MODELS)
            if self.auto_recover < 0:
                raise ConfigurationError("auto_recover counts.", got=self.auto_recover, allowed="0 or more")
