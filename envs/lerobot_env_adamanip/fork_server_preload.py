"""Preloads simulator and fingerprint in the process from which workers are forked; imported for this effect."""

from lerobot_env_adamanip.fingerprint import code_fingerprint
from lerobot_env_adamanip.simulator import require_simulator

require_simulator()
code_fingerprint()
