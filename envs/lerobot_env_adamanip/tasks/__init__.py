"""Plain ManiSkill: importing this registers every task; then ``gymnasium.make("AdaManip-Safe-v1")`` makes one."""

from lerobot_env_adamanip.tasks.base import AdaManipTask
from lerobot_env_adamanip.tasks.bottle import BottleTask
from lerobot_env_adamanip.tasks.coffee_maker import CoffeeMakerTask
from lerobot_env_adamanip.tasks.door import DoorTask
from lerobot_env_adamanip.tasks.lamp import LampTask
from lerobot_env_adamanip.tasks.microwave import MicrowaveTask
from lerobot_env_adamanip.tasks.pen import PenTask
from lerobot_env_adamanip.tasks.pressure_cooker import PressureCookerTask
from lerobot_env_adamanip.tasks.safe import SafeTask
from lerobot_env_adamanip.tasks.window import WindowTask

__all__ = [
    "AdaManipTask", "BottleTask", "CoffeeMakerTask", "DoorTask", "LampTask", "MicrowaveTask", "PenTask",
    "PressureCookerTask", "SafeTask", "WindowTask",
]  # fmt: skip
