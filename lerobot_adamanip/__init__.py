"""AdaManip for LeRobot: the core, free of simulators, diffusers and robot drivers."""

import sys

from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.moved import MovedModules

__all__ = ["NO_PLUGIN", "AdaManipError", "__version__"]
__version__ = "0.2.0"

NO_PLUGIN = "ADAMANIP_NO_PLUGIN"
"""Environment variable with which a command keeps itself and its workers from registering a plugin with LeRobot."""

if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
    sys.meta_path.append(MovedModules())
