"""Plain ManiSkill: importing this registers every task; then ``gymnasium.make("AdaManip-Safe-v1")`` makes one."""

from lerobot_env_adamanip.own_kinematics import import_sapien

import_sapien()

from lerobot_env_adamanip.sim.tasks import *  # noqa: E402, F403
