"""Preloads the simulator in the process from which workers are forked; imported for this effect."""

from lerobot_env_adamanip.simulator import require_simulator

require_simulator()
