"""Generator of pressure cookers."""

from lerobot_adamanip.objects.drawing import makers
from lerobot_adamanip.objects.pressure_cooker.design import PressureCookerDesign, draw_novel_design
from lerobot_adamanip.objects.pressure_cooker.generator import build_pressure_cooker

make_pressure_cooker, make_novel_pressure_cooker = makers(
    "pressure_cooker", 0xC270, PressureCookerDesign, draw_novel_design, build_pressure_cooker
)

__all__ = ["make_novel_pressure_cooker", "make_pressure_cooker"]
