"""Coffee makers; see `make_coffee_maker`."""

from lerobot_adamanip.objects.coffee_maker.design import CoffeeMakerDesign, draw_design
from lerobot_adamanip.objects.coffee_maker.generator import (
    DROP_UPPER,
    PORTAFILTER_RANGE,
    build_coffee_maker,
    make_coffee_maker,
)

__all__ = [
    "DROP_UPPER",
    "PORTAFILTER_RANGE",
    "CoffeeMakerDesign",
    "build_coffee_maker",
    "draw_design",
    "make_coffee_maker",
]
