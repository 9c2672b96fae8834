"""Device classes. LeRobot looks for them next to `config_devices`."""

from lerobot_env_adamanip.twin.franka_sim import AdamanipFrankaSim
from lerobot_env_adamanip.twin.scripted import AdamanipScripted
from lerobot_env_adamanip.twin.twin_camera import AdamanipTwin

__all__ = ["AdamanipFrankaSim", "AdamanipScripted", "AdamanipTwin"]
