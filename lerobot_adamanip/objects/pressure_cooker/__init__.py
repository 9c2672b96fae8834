"""Pressure cookers; see `generator`."""

from lerobot_adamanip.objects.pressure_cooker.design import PressureCookerDesign, draw_design
from lerobot_adamanip.objects.pressure_cooker.generator import (
    LID_RANGE,
    LIFT_UPPER,
    build_pressure_cooker,
    make_pressure_cooker,
)
from lerobot_adamanip.objects.pressure_cooker.parts import GAP, HANDLE_GAP

__all__ = [
    "GAP", "HANDLE_GAP", "LID_RANGE", "LIFT_UPPER", "PressureCookerDesign", "build_pressure_cooker", "draw_design",
    "make_pressure_cooker",
]  # fmt: skip
