"""Plain ManiSkill: importing this registers every task; then ``gymnasium.make("AdaManip-Safe-v1")`` makes one."""

from lerobot_env_adamanip.tasks.base import AdaManipTask
from lerobot_env_adamanip.tasks.safe import SafeTask

__all__ = ["AdaManipTask", "SafeTask"]
