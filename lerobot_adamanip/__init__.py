"""AdaManip for LeRobot: the core, free of simulators, diffusers and robot drivers."""

from lerobot_adamanip.util.errors import AdaManipError

__all__ = ["NO_PLUGIN", "AdaManipError", "__version__"]
__version__ = "0.3.0.dev0"

NO_PLUGIN = "ADAMANIP_NO_PLUGIN"
"""Environment variable with which a command keeps itself and its workers from registering a plugin with LeRobot."""
