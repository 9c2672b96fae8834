"""Bottles; see `make_bottle`."""

from lerobot_adamanip.objects.bottle.generator import CAP_RANGE, BottleDesign, build_bottle, draw_design, make_bottle

__all__ = ["CAP_RANGE", "BottleDesign", "build_bottle", "draw_design", "make_bottle"]
