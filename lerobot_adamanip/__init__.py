"""AdaManip for LeRobot: the core, free of simulators, diffusers and robot drivers."""

__version__ = "0.2.0"

NO_PLUGIN = "ADAMANIP_NO_PLUGIN"
"""Environment variable with which a command keeps itself and its workers from registering a plugin with LeRobot."""
