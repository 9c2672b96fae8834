"""Plain ManiSkill: importing this registers every task; then ``gymnasium.make("AdaManip-Safe-v1")`` makes one."""

from lerobot_env_adamanip.sim.tasks.base import AdaManipTask
from lerobot_env_adamanip.sim.tasks.bottle import BottleTask
from lerobot_env_adamanip.sim.tasks.coffee_maker import CoffeeMakerTask
from lerobot_env_adamanip.sim.tasks.door import DoorTask
from lerobot_env_adamanip.sim.tasks.lamp import LampTask
from lerobot_env_adamanip.sim.tasks.microwave import MicrowaveTask
from lerobot_env_adamanip.sim.tasks.pen import PenTask
from lerobot_env_adamanip.sim.tasks.pressure_cooker import PressureCookerTask
from lerobot_env_adamanip.sim.tasks.safe import SafeTask
from lerobot_env_adamanip.sim.tasks.window import WindowTask

__all__ = [
    "AdaManipTask", "BottleTask", "CoffeeMakerTask", "DoorTask", "LampTask", "MicrowaveTask", "PenTask",
    "PressureCookerTask", "SafeTask", "WindowTask",
]  # fmt: skip
