"""Generator of coffee makers."""

from lerobot_adamanip.objects.coffee_maker.generator import CoffeeMakerDesign, build_coffee_maker, draw_novel_design
from lerobot_adamanip.objects.drawing import makers

make_coffee_maker, make_novel_coffee_maker = makers(
    "coffee_maker", 0xCAFA, CoffeeMakerDesign, draw_novel_design, build_coffee_maker
)

__all__ = ["make_coffee_maker", "make_novel_coffee_maker"]
