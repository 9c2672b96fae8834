"""Plain ManiSkill: importing this registers all tasks; then ``gymnasium.make("AdaManip-Safe-v1")`` creates one."""

from lerobot_env_adamanip.sim.tasks import *  # noqa: F403
