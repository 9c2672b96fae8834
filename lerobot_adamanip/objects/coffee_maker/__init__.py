"""Generator of coffee makers."""

from lerobot_adamanip.objects.coffee_maker.generator import make_coffee_maker, make_novel_coffee_maker

__all__ = ["make_coffee_maker", "make_novel_coffee_maker"]
