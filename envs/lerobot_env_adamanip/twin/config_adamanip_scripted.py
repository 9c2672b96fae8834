"""Options of the teleoperator that plays experts."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_adamanip.hardware.teleoperators.config_tcp_teleop import TcpTeleopConfig


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
    """Failed tries before the expert changes its mind."""

    seed: int = 0
    """Of what the expert leaves to chance; an episode's own seed comes on top."""

    stay: float = 0.5
    """Once the expert has ended, the episode that is being recorded goes on for so long [s] and is ended then."""
