"""Generator of microwaves."""

from lerobot_adamanip.objects.base import makers
from lerobot_adamanip.objects.microwave.generator import build_microwave, draw_design, draw_novel_design

make_microwave, make_novel_microwave = makers("microwave", 0x0FE4, draw_design, draw_novel_design, build_microwave)

__all__ = ["make_microwave", "make_novel_microwave"]
