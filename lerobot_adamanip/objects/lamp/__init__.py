"""Generator of lamps."""

from lerobot_adamanip.objects.lamp.generator import make_lamp
from lerobot_adamanip.objects.lamp.novel import make_novel_lamp

__all__ = ["make_lamp", "make_novel_lamp"]
