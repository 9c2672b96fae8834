"""The classes that LeRobot looks for beside `config_devices`; their SDKs are imported when a device is opened."""

from lerobot_adamanip.hardware.teleoperators.gamepad import AdamanipGamepad
from lerobot_adamanip.hardware.teleoperators.keyboard import AdamanipKeyboard
from lerobot_adamanip.hardware.teleoperators.phone import AdamanipPhone
from lerobot_adamanip.hardware.teleoperators.spacemouse import AdamanipSpacemouse

__all__ = ["AdamanipGamepad", "AdamanipKeyboard", "AdamanipPhone", "AdamanipSpacemouse"]
