"""Generator of bottles."""

from lerobot_adamanip.objects.bottle.generator import make_bottle, make_novel_bottle

__all__ = ["make_bottle", "make_novel_bottle"]
