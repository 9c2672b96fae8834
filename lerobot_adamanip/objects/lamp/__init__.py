"""Generator of lamps."""

from lerobot_adamanip.objects.base import makers
from lerobot_adamanip.objects.lamp.generator import build_lamp, draw_design
from lerobot_adamanip.objects.lamp.novel import draw_novel_design

make_lamp, make_novel_lamp = makers("lamp", 0x1A3B, draw_design, draw_novel_design, build_lamp)

__all__ = ["make_lamp", "make_novel_lamp"]
