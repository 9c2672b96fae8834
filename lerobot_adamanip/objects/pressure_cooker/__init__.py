"""Generator of pressure cookers."""

from lerobot_adamanip.objects.pressure_cooker.generator import make_novel_pressure_cooker, make_pressure_cooker

__all__ = ["make_novel_pressure_cooker", "make_pressure_cooker"]
