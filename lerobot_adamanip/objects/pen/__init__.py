"""Generator of pens."""

from lerobot_adamanip.objects.pen.generator import make_novel_pen, make_pen

__all__ = ["make_novel_pen", "make_pen"]
