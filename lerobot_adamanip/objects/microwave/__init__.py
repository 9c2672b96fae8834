"""Microwave ovens; see `make_microwave`."""

from lerobot_adamanip.objects.microwave.generator import (
    DOOR_UPPER,
    FINGER_TIP,
    GRASP_REACH,
    MicrowaveDesign,
    build_microwave,
    draw_design,
    make_microwave,
)

__all__ = [
    "DOOR_UPPER",
    "FINGER_TIP",
    "GRASP_REACH",
    "MicrowaveDesign",
    "build_microwave",
    "draw_design",
    "make_microwave",
]
