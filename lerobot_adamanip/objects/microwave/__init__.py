"""Generator of microwaves."""

from lerobot_adamanip.objects.drawing import makers
from lerobot_adamanip.objects.microwave.generator import MicrowaveDesign, build_microwave, draw_novel_design

make_microwave, make_novel_microwave = makers("microwave", 0x0FE4, MicrowaveDesign, draw_novel_design, build_microwave)

__all__ = ["make_microwave", "make_novel_microwave"]
