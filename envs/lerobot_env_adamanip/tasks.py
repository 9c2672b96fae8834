"""Plain ManiSkill: importing this registers every task; then ``gymnasium.make("AdaManip-Safe-v1")`` makes one."""

from lerobot_env_adamanip.sim.tasks import *  # noqa: F403
