"""Imported for its effects by the process that workers are forked from: simulator and fingerprint are there then."""

from lerobot_env_adamanip.fingerprint import code_fingerprint
from lerobot_env_adamanip.simulator import require_simulator

require_simulator()
code_fingerprint()
