"""Lamps; see `make_lamp`."""

from lerobot_adamanip.objects.lamp.generator import GRIP_DEPTH, LampDesign, build_lamp, draw_design, make_lamp

__all__ = ["GRIP_DEPTH", "LampDesign", "build_lamp", "draw_design", "make_lamp"]
