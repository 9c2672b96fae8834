"""Generator of lamps."""

from lerobot_adamanip.objects.drawing import makers
from lerobot_adamanip.objects.lamp.generator import LampDesign, build_lamp
from lerobot_adamanip.objects.lamp.novel import draw_novel_design

make_lamp, make_novel_lamp = makers("lamp", 0x1A3B, LampDesign, draw_novel_design, build_lamp)

__all__ = ["make_lamp", "make_novel_lamp"]
