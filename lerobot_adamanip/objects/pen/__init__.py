"""Pens; see `make_pen`."""

from lerobot_adamanip.objects.pen.generator import CAP_RANGE, PenDesign, build_pen, draw_design, make_pen

__all__ = ["CAP_RANGE", "PenDesign", "build_pen", "draw_design", "make_pen"]
