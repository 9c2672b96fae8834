"""Options that all teleoperators of a tool pose share."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig


@dataclass(kw_only=True)
class TcpTeleopConfig(TeleoperatorConfig):
    """Of a teleoperator that integrates one absolute tool goal."""

    robot_id: str | None = None
    """Id of the robot it drives (``--robot.id``); left out, the only robot of the command."""

    speed: float = 0.10
    """At full deflection [m/s]; the robot's own limit comes on top."""

    angular_speed: float = 0.4
    """Likewise [rad/s]."""
