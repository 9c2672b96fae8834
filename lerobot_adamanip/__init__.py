"""AdaManip for LeRobot: the core, free of simulators, diffusers and robot drivers."""

__version__ = "0.2.0"
